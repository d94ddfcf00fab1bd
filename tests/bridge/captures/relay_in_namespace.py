"""Two captures of tcpdump around a relay, in a namespace of its own: ``inside.py FOLDER``."""

import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

folder = Path(sys.argv[1])
N, HERE, THERE = 200, ("127.0.0.1", 6000), ("127.0.0.1", 6001)
WAITS = [0.002 + 0.001 * (k * 7 % 10) for k in range(N)]  # s, by packet
DROPPED = [k % 13 == 5 for k in range(N)]


def capture(name: str, port: int) -> subprocess.Popen[bytes]:
    call = ["tcpdump", "--immediate-mode", "-i", "lo", "-U", "-Z", "root", "-w", str(folder / name)]
    call += ["--time-stamp-precision=nano", f"udp dst port {port}"]
    found = subprocess.Popen(call, stderr=subprocess.PIPE)
    assert found.stderr is not None
    while b"listening on" not in (line := found.stderr.readline()):
        assert line, "tcpdump does not listen"
    return found


def relay(inlet: socket.socket, outlet: socket.socket) -> None:
    for _ in range(N):
        data = inlet.recv(100)
        k = int.from_bytes(data[:4], "big")
        time.sleep(WAITS[k])
        if not DROPPED[k]:
            outlet.sendto(data, THERE)


captures = [capture("here.pcap", HERE[1]), capture("there.pcap", THERE[1])]
inlet, sink, out = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3))
inlet.bind(HERE)
sink.bind(THERE)
thread = threading.Thread(target=relay, args=(inlet, out))
thread.start()
for k in range(N):
    out.sendto(k.to_bytes(4, "big") + b"payload", HERE)
    time.sleep(0.005)
thread.join()
time.sleep(0.5)
for each in captures:
    each.terminate()
    each.wait()
(folder / "truth.json").write_text(json.dumps({"waits": WAITS, "dropped": DROPPED}))
