"""strict Damiao drives on python-can: registers, TIMEOUT watchdog, error nibble. Run in netns."""

import can, time, threading, sys, struct, json


class Drive:
    def __init__(s, n, q):
        s.n = n
        s.q = q
        s.state = 0
        s.timeout = 0
        s.last = 0
        s.ev = []
        s.gap = 0
        s.taus = []
        s.frames = 0
        s.force = None


class Arm:
    def __init__(s, chan, ns, q, fd=False, t0=0, ranges=None):
        s.bus = can.Bus(interface="udp_multicast", channel=chan, fd=True)
        s.bus._multicast._socket.setsockopt(0, 49, 0)
        s.d = {n: Drive(n, q[i]) for i, n in enumerate(ns)}
        s.seen = []
        s.run = True
        s.fd = fd
        s.t0 = t0
        s.R = ranges or {n: (12.5, 30, 10) for n in ns}
        s.th = threading.Thread(target=s.loop, daemon=True)
        s.th.start()

    def log(s, d, *a):
        d.ev.append((round(time.monotonic() - s.t0, 4),) + a)

    def send(s, i, data):
        s.bus.send(
            can.Message(
                arbitration_id=i, is_extended_id=False, data=data, is_fd=s.fd, bitrate_switch=s.fd
            )
        )

    def loop(s):
        import os

        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
        while s.run:
            m = s.bus.recv(0.001)
            now = time.monotonic()
            if m is not None:
                s.seen.append((now - s.t0, m.arbitration_id, bytes(m.data).hex()))
            for d in s.d.values():
                if d.timeout and d.state == 1 and now - d.last > d.timeout * 50e-6:
                    d.state = 0xD
                    s.log(d, "LOST_COMM after %.1f ms" % ((now - d.last) * 1e3))
            if m is None or m.is_error_frame:
                continue
            D = bytes(m.data)
            if m.arbitration_id == 0x7FF:
                d = s.d.get(D[0])
                if d is None:
                    continue
                if D[2] == 0x55 and D[3] == 9:
                    d.timeout = struct.unpack("<I", D[4:8])[0]
                    s.log(d, "write TIMEOUT", d.timeout)
                reg = {
                    9: struct.pack("<I", d.timeout),
                    10: struct.pack("<I", 1),
                    21: struct.pack("<f", s.R[d.n][0]),
                    22: struct.pack("<f", s.R[d.n][1]),
                    23: struct.pack("<f", s.R[d.n][2]),
                }.get(D[3], bytes(4))
                s.log(d, "reg", hex(D[2]), D[3])
                s.send(0x10 + d.n, bytes([d.n, 0, D[2], D[3]]) + reg)
                continue
            d = s.d.get(m.arbitration_id)
            if d is None:
                continue
            if D[:7] == b"\xff" * 7:
                s.log(d, {0xFC: "ENABLE", 0xFD: "DISABLE", 0xFB: "CLEAR"}.get(D[7], hex(D[7])))
                if D[7] == 0xFC and d.state == 0:
                    d.state = 1
                if D[7] == 0xFD:
                    d.state = 0
                if D[7] == 0xFB and d.state > 1:
                    d.state = 0
                d.last = now
            elif len(D) == 8:
                g = now - d.last
                d.gap = max(d.gap, g) if d.frames else 0
                d.last = now
                d.frames += 1
                tau = (((D[6] & 15) << 8 | D[7]) / 4095 * 2 - 1) * s.R[d.n][2]
                d.taus.append((round(now - s.t0, 4), round(tau, 3), d.state))
            st = d.force if d.force is not None else d.state
            P, V, T = s.R[d.n]
            q = round((d.q + P) / (2 * P) * 65535)
            v = 2048
            t = 2048
            s.send(
                0x10 + d.n,
                bytes(
                    [
                        d.n | st << 4,
                        q >> 8,
                        q & 255,
                        v >> 4,
                        (v & 15) << 4 | t >> 8,
                        t & 255,
                        30,
                        30,
                    ]
                ),
            )
