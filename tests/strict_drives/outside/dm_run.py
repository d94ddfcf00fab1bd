import subprocess as sp, sys, time, json, threading, os
from dm import *

name, deploy, scen, ns, fault = sys.argv[1:6]
extra = sys.argv[6:]
ns = json.loads(ns)
fd = deploy.startswith("openarm")
t0 = time.monotonic()
L = Arm("239.74.163.%d" % json.loads(os.environ.get("CH", "[2,4]"))[0], ns, [0.3] * len(ns), fd, t0)
Rr = Arm(
    "239.74.163.%d" % json.loads(os.environ.get("CH", "[2,4]"))[1], ns, [0.3] * len(ns), fd, t0
)
p = sp.Popen(
    [
        "cosim",
        "rehearse",
        scen,
        "--deploy",
        deploy,
        "-i",
        "udp_multicast",
        "--nodes",
        "master_control,slave_control",
        "--hardware",
        "--yes",
        "--set",
        'run.stop="3 s"',
        "--out",
        "u/" + name,
        "--force",
        "--no-plot",
        "--no-twin",
        *extra,
    ],
    stdout=sp.PIPE,
    stderr=sp.STDOUT,
    text=True,
)


def inject():
    while not any("ENABLE" in e[1] for e in L.d[ns[0]].ev):
        time.sleep(0.01)
    te = time.monotonic()
    time.sleep(2.0)
    if fault != "none":
        for d in L.d.values():
            d.force = int(fault, 16)
            L.log(d, "FORCED state %s" % fault)


threading.Thread(target=inject, daemon=True).start()
o = p.communicate(timeout=120)[0]
time.sleep(0.3)
print(
    "\n".join(
        l for l in o.splitlines() if not l.startswith(("age ", "  slots", "bus ", "not granted"))
    ),
    "rc",
    p.returncode,
)
for nm, A in (("left", L), ("right", Rr)):
    for d in list(A.d.values())[:2]:
        print(
            nm,
            d.n,
            "timeout",
            d.timeout,
            "frames",
            d.frames,
            "max gap %.1f ms" % (d.gap * 1e3),
            "final state",
            d.state,
        )
        ev = d.ev
        print("   ", ev[:14], "...", ev[-3:] if len(ev) > 14 else "")
        tt = [x for x in d.taus if abs(x[1]) > 0.02]
        print(
            "    taus nonzero",
            len(tt),
            tt[:2],
            tt[-2:],
            "max",
            max((abs(x[1]) for x in d.taus), default=0),
            "commanded nonzero while drive not enabled:",
            sum(1 for x in tt if x[2] != 1),
            "after forced:",
            sum(1 for x in tt if any(e[1].startswith("FORCED") and x[0] > e[0] for e in ev)),
        )

import pickle

pickle.dump([A.seen for A in (L, Rr)], open("u/%s.seen" % name, "wb"))
for nm, A in (("left", L), ("right", Rr)):
    n = ns[0]
    e = [x for x in A.d[n].ev if x[1] == "ENABLE"]
    if not e:
        continue
    te = e[0][0]
    ts = [x[0] for x in A.d[n].taus if abs(x[1]) > 0.02][:1]
    T = [
        x[0] - te
        for x in A.seen
        if x[1] == n and x[0] > te - 0.01 and (not ts or x[0] < ts[0] + 0.02)
    ]
    print(
        nm,
        "frames to drive",
        n,
        "from ENABLE to first torque (%.1f ms): arrival gaps ms"
        % ((ts[0] - te) * 1e3 if ts else -1),
        [round((b - a) * 1e3, 1) for a, b in zip(T, T[1:])],
    )
