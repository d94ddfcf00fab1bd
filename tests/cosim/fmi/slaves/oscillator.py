"""A Python class as PythonFMU exports it (FMI 2.0): an oscillator, semi-implicit Euler."""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String

OUTPUT = {"causality": Fmi2Causality.output}


class Oscillator(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x, self.v, self.u, self.k, self.n, self.up, self.who = (
            1.0,
            0.0,
            0.0,
            4.0,
            0,
            True,
            "me",
        )
        tunable = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("x", **OUTPUT))
        self.register_variable(Real("u", causality=Fmi2Causality.input, start=0.0))
        self.register_variable(Real("k", **tunable))
        self.register_variable(Integer("n", **OUTPUT))
        self.register_variable(Boolean("up", **OUTPUT))
        self.register_variable(String("who", **OUTPUT))

    def do_step(self, t, h):
        if self.k < 0.0:
            raise ValueError("a negative spring")
        self.v += h * (self.u - self.k * self.x)
        self.x += h * self.v
        self.n += 1
        self.up = self.x > 0.0
        return True
