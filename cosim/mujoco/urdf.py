"""Contents of a URDF that MuJoCo leaves out or does in its own way; refused, or remarks.

MuJoCo does not compare a URDF with a schema: a misspelt word is skipped. ``cosim.base.urdf`` has
the words of the format.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from cosim.base.errors import MujocoError
from cosim.base.urdf import unread, wrong_word
from cosim.mujoco.library import package


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: q = offset + factor q_other, both in rad or m.

    `joint`, `other`: indices in the model.
    """

    joint: int
    other: int
    factor: float
    offset: float


def urdf_root(path: Path) -> Element | None:
    """The element <robot> of a URDF; None for an MJCF file. Raises MujocoError for broken XML."""
    text = path.read_bytes()
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        if b"<robot" not in text:
            return None  # MuJoCo's reader of MJCF is less strict
        raise MujocoError(f"{path}: is not XML: {error}") from None
    return root if root.tag == "robot" else None


def check_words(path: Path, root: Element) -> None:
    """Raise MujocoError for a word of a joint or an inertia that the format does not have."""
    if (wrong := wrong_word(root)) is not None:
        raise MujocoError(f"{path}, {wrong[0]}: {wrong[1]}")


def mimics(path: Path, root: Element, model: Any) -> tuple[Mimic, ...]:
    """The joints that follow others. Raises MujocoError for one that MuJoCo lets move freely."""
    mujoco = package()
    held = [
        (int(a), int(b))
        for a, b, kind in zip(model.eq_obj1id, model.eq_obj2id, model.eq_type, strict=True)
        if int(kind) == int(mujoco.mjtEq.mjEQ_JOINT)
    ]
    found = []
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        name, other = joint.get("name", ""), mimic.get("joint", "")
        pair = tuple(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, x) for x in (name, other))
        if pair not in held:
            raise MujocoError(
                f"{path}, joint {name!r}: it mimics {other!r}, but MuJoCo "
                f"{mujoco.mj_versionString()} lets it move by itself; expected two hinges or "
                "slides of the file, or an MJCF file with <equality>"
            )
        factor, offset = mimic.get("multiplier", "1"), mimic.get("offset", "0")
        found.append(Mimic(*pair, float(factor), float(offset)))
    return tuple(found)


def urdf_remarks(root: Element, model: Any) -> Iterator[str]:
    """Statements of the file that the scene obeys otherwise, a sentence each."""
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            yield (
                f"the joint {joint.get('name')!r} mimics {mimic.get('joint')!r}: MuJoCo holds it by"
                " a soft constraint, and it has entries of its own in q, dq and tau"
            )
    for word, meaning in (("effort", "tau may exceed it"), ("velocity", "dq may exceed it")):
        limited = [j.get("name") for j in root.findall("joint") if 0 < _limit(j, word) < inf]
        if limited:
            names = ", ".join(map(repr, limited))
            yield f"the limit {word!r} of the joints {names} does not act: {meaning}"
    yield from unread(root)
    yield from _shapes_as_masses(root, model)


def _limit(joint: Element, word: str) -> float:
    """A limit of a joint that moves, 0 without one."""
    limit = joint.find("limit")
    moves = joint.get("type") in ("revolute", "continuous", "prismatic")
    return float(limit.get(word, "0")) if moves and limit is not None else 0.0


def _shapes_as_masses(root: Element, model: Any) -> Iterator[str]:
    """Links without <inertial> to which MuJoCo gives the mass of their shapes."""
    mujoco = package()
    for link in root.findall("link"):
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link.get("name", ""))
        if link.find("inertial") is None and body > 0 and model.body_mass[body] > 0.0:
            yield (
                f"the link {link.get('name')!r} has no <inertial>: MuJoCo gives it"
                f" {model.body_mass[body]:.4g} kg, its shapes with the density of water"
            )
