"""A node in memory as C data: every value, every pointer; names of kernels that do not clash."""

from __future__ import annotations

import ctypes as c
import re
from math import inf, nan

import pytest

from bridge.export.image import NodeImage, braces, number
from bridge.export.kernels import kernels
from bridge.export.plan_source import node_data
from bridge.native import node as native
from bridge.replay import twin
from cosim.base.errors import CosimError
from tests.bridge.deployments import named


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"), (inf, "INFINITY"), (-inf, "-INFINITY"), (nan, "NAN"), (-3, "-3"),
        (-(1 << 63), "INT64_MIN"), (1 << 40, f"INT64_C({1 << 40})"),
        ((1 << 64) - 1, f"UINT64_C({(1 << 64) - 1})"),
    ],
)  # fmt: skip
def test_a_literal_has_the_value(value, text):
    assert number(value) == text


def test_initializers_are_broken_into_lines():
    entries = [str(10**9 + i) for i in range(30)]
    text = braces(entries)
    assert max(map(len, text.splitlines())) <= 100
    assert text.strip("{}").replace("\n", "").replace(" ", "").split(",") == entries


def test_every_value_of_a_node_is_in_its_c(tmp_path):
    found = named("can-one-bus", "run.stop=0.1")
    with twin.wired_nodes(found, tmp_path) as nodes:
        node = nodes["master_control"]
        node.inlet_bindings.inlets[1].gain = 2.5
        kernel = kernels([(s.name, s.component) for s in node.plan.plan.components])
        text = re.sub(r"\s+", " ", node_data(node, kernel)["node_data.c"])
    assert ".phase_ns = 500000" in text and ".gain = 2.5" in text
    assert ".number = 2" in text and ".id = 930," in text  # the node, LINK_2 = 0x3a2
    assert "{1000000u, 5000000u}" in text
    pointers = re.findall(r"offsetof\(memory_t, ([^)]+)\)", text)
    assert {"node.inlets", "inlets_26[0].reception", "gates[0].context"} <= {
        re.sub(r"inlets_\d+", "inlets_26", p) for p in pointers
    }
    assert len(pointers) == len(set(pointers))


def test_a_pointer_that_nobody_knows_is_refused():
    struct = native.NodeStruct()
    image = NodeImage(struct)
    assert image.pointer(c.addressof(struct), native.NodeStruct, "x.node") == (
        "(node_t *)&node_first.node"
    )
    with pytest.raises(CosimError, match=r"belongs to no part of the node: x\.node"):
        image.pointer(c.addressof(struct) + 8, native.NodeStruct, "x.node")
    outlet = (native.OutletStruct * 1)()
    history = native.HistoryStruct()
    outlet[0].history = c.pointer(history)
    struct.outlets, struct.n_outlets = outlet, 1
    with pytest.raises(CosimError, match=r"OutletStruct\.history: found a pointer, expected none"):
        NodeImage(struct)


def test_each_model_has_its_own_names_and_is_there_once():
    found = named("network-can")
    steps = [s for node in found.nodes.values() for s in node.plan.components]
    made = kernels([(s.name, s.component) for s in steps])
    assert len(made) == 12 and len({k.name for k in made.values()}) < 12
    defined = []
    for kernel in {k.name: k for k in made.values()}.values():
        files = kernel.sources()
        assert f"#define kernel_step {kernel.name}_kernel_step" in files[f"{kernel.name}/names.h"]
        assert kernel.size == max(a + n for a, n in kernel.places.values())
        defined += [name for name in files if "/" not in name]
    assert len(defined) == len(set(defined))
