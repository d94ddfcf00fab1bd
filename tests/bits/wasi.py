"""``python -m tests.bits.wasi node|wasmtime PROGRAM``: run a program for WASI, for its output."""

from __future__ import annotations

import subprocess
import sys

from tests.cosim.live.node import node

_IN_NODE = """
const {WASI} = require("node:wasi"), fs = require("fs");
const wasi = new WASI({version: "preview1"});
const module = new WebAssembly.Module(fs.readFileSync(process.argv[1]));
const instance = new WebAssembly.Instance(module, wasi.getImportObject());
process.exitCode = wasi.start(instance);
"""


def in_wasmtime(program: str) -> int:
    """Run a program by wasmtime; its exit code."""
    from wasmtime import Engine, ExitTrap, Linker, Module, Store, WasiConfig

    linker = Linker(Engine())
    linker.define_wasi()
    store, wasi = Store(linker.engine), WasiConfig()
    wasi.inherit_stdout()
    store.set_wasi(wasi)
    instance = linker.instantiate(store, Module.from_file(linker.engine, program))
    try:
        instance.exports(store)["_start"](store)
    except ExitTrap as end:
        return end.code
    return 0


def in_node(program: str) -> int:
    """Run a program by Node; its exit code."""
    call = [node(), "--no-warnings", "-e", _IN_NODE, program]
    return subprocess.run(call, check=False).returncode


if __name__ == "__main__":
    run = {"node": in_node, "wasmtime": in_wasmtime}[sys.argv[1]]
    raise SystemExit(run(sys.argv[2]))
