"""A Python class as PythonFMU3 exports it (FMI 3.0): an oscillator, semi-implicit Euler."""

from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability, Int32
from pythonfmu3.cosimulation import CoSimulation
from pythonfmu3.fmi3slave import Fmi3StepResult

OUTPUT = {"causality": Fmi3Causality.output}


class Oscillator3(Fmi3Slave, CoSimulation):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time = 0.0
        self.x, self.v, self.u, self.k, self.n, self.up = 1.0, 0.0, 0.0, 4.0, 0, True
        independent = {"causality": Fmi3Causality.independent}
        tunable = {"causality": Fmi3Causality.parameter, "variability": Fmi3Variability.tunable}
        self.register_variable(
            Float64("time", variability=Fmi3Variability.continuous, **independent)
        )
        self.register_variable(Float64("x", **OUTPUT))
        self.register_variable(Float64("u", causality=Fmi3Causality.input, start=0.0))
        self.register_variable(Float64("k", **tunable))
        self.register_variable(Int32("n", **OUTPUT))
        self.register_variable(Boolean("up", **OUTPUT))

    def do_step(self, t, h):
        if self.k < 0.0:
            raise ValueError("a negative spring")
        self.v += h * (self.u - self.k * self.x)
        self.x += h * self.v
        self.n += 1
        self.up = self.x > 0.0
        return Fmi3StepResult()
