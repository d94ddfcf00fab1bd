"""Writes the DBC files of Damiao drives next to it: ``python configs/drives/generate.py``.

All types have the same two messages in MIT mode. The codes span the ranges in the drive's
registers PMAX, VMAX and TMAX (21 to 23), so a type is a row of TYPES. Look at those of your own
drive: where host and drive do not agree, every value is wrong by their ratio.
"""

from __future__ import annotations

from pathlib import Path

#: File -> type, PMAX (rad), VMAX (rad/s), TMAX (N.m).
TYPES = {
    "damiao.dbc": ("DM4310", 12.5, 30, 10),
    "damiao_4340.dbc": ("DM4340", 12.5, 10, 28),
    "damiao_8009.dbc": ("DM8009", 12.5, 45, 54),
}
#: Signal -> start bit (Motorola), bits, unit, range; None: that of the registers.
COMMAND = {
    "q_des": (7, 16, "rad", None),
    "dq_des": (23, 12, "rad/s", None),
    "kp": (27, 12, "N.m/rad", (0, 500)),
    "kd": (47, 12, "N.m.s/rad", (0, 5)),
    "tau": (51, 12, "N.m", None),
}
FEEDBACK = {
    "node": (3, 4, "", (0, 15)),
    "state": (7, 4, "", (0, 15)),
    "q": (15, 16, "rad", None),
    "dq": (31, 12, "rad/s", None),
    "tau": (35, 12, "N.m", None),
    "t_mos": (55, 8, "degC", (0, 255)),
    "t_rotor": (63, 8, "degC", (0, 255)),
}
#: Of PMAX; positions beyond it are not believed. Drives answer for registers with the identifier of
#: feedback, where 33 and 55 (hexadecimal) in byte 2 would be a position next to -PMAX.
BELIEVED = 0.992
REGISTERS = "ranges are the registers PMAX, VMAX, TMAX"
STATES = {
    **{0: "DISABLED", 1: "ENABLED", 8: "OVER_VOLTAGE", 9: "UNDER_VOLTAGE", 10: "OVER_CURRENT"},
    **{11: "MOS_OVER_TEMPERATURE", 12: "ROTOR_OVER_TEMPERATURE", 13: "LOST_COMMUNICATION"},
    14: "OVERLOAD",
}


def _number(x: float) -> str:
    return repr(int(x) if x == int(x) else x)


def _lines(signals: dict, ranges: dict[str, float], receiver: str) -> list[str]:
    found = []
    for name, (start, bits, unit, given) in signals.items():
        low, high = given or (-ranges[name.removesuffix("_des")], ranges[name.removesuffix("_des")])
        scale = (high - low) / (2**bits - 1)
        share = BELIEVED if name == "q" else 1
        ends = f"{_number(share * low)}|{_number(share * high)}"
        values = f"({_number(scale)},{_number(low)}) [{ends}]"
        found.append(f' SG_ {name} : {start}|{bits}@0+ {values} "{unit}" {receiver}')
    return found


def text(kind: str, q: float, dq: float, tau: float) -> str:
    """The file of a type: ranges ±q rad, ±dq rad/s, ±tau N.m."""
    ranges = {"q": q, "dq": dq, "tau": tau}
    least = 1e3 * tau / 4095
    codes = f"No code is 0 N.m: 2047 is -{least:.1f} mN.m, 2048 +{least:.1f} mN.m."
    states = " ".join(f'{number} "{state}"' for number, state in STATES.items())
    lines = [
        'VERSION ""', "", "NS_ :", "", "BS_:", "", "BU_: HOST DRIVE", "",
        "BO_ 0 COMMAND: 8 HOST", *_lines(COMMAND, ranges, "DRIVE"), "",
        "BO_ 16 FEEDBACK: 8 DRIVE", *_lines(FEEDBACK, ranges, "HOST"), "",
        f'CM_ "Damiao {kind}, MIT mode: identifiers of node 0; {REGISTERS}.";',
        f'CM_ SG_ 0 tau "{codes}";',
        'BA_DEF_ SG_ "GenSigStartValue" FLOAT -2147483648 2147483647;',
        'BA_DEF_DEF_ "GenSigStartValue" 0;',
        'BA_ "GenSigStartValue" SG_ 0 q_des 32768;',
        'BA_ "GenSigStartValue" SG_ 0 dq_des 2048;',
        'BA_ "GenSigStartValue" SG_ 16 state 1;',
        'BA_ "GenSigStartValue" SG_ 16 t_mos 25;',
        'BA_ "GenSigStartValue" SG_ 16 t_rotor 25;',
        f"VAL_ 16 state {states} ;",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def files() -> dict[str, str]:
    """Name -> contents."""
    return {name: text(*values) for name, values in TYPES.items()}


if __name__ == "__main__":
    for name, contents in files().items():
        Path(__file__).with_name(name).write_text(contents, encoding="ascii")
