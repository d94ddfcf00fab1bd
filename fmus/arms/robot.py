"""The hook by which a scenario gives a robot to a model: ``prepare = of_robot(model)``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.base.component import Preparation
    from fmus.model import Model


def of_robot(model: Callable[..., Model]) -> Callable[[Mapping[str, Any], Path], Preparation]:
    """The hook ``prepare(options, folder)`` of a `model` with the size `joints`.

    It gives those of the parameters of the model that the robot determines; the options are those
    of :mod:`fmus.arms.options`. It raises ScenarioError for options or a file that cannot be.
    """

    def prepare(options: Mapping[str, Any], folder: Path) -> Preparation:
        from fmus.arms.options import prepare as of_options

        return of_options(model, options, folder)

    return prepare
