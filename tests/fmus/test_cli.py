"""The command `fmus`: what it prints, what it makes, how it fails."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cosim.base.errors import CosimError
from fmus import cli
from fmus.build.archive import SHIPPED, find, shipped_models, toolchain
from fmus.models import xi


def call(*arguments: str) -> tuple[int, str]:
    """Exit code and what is printed, as the console script would have it."""
    result = CliRunner().invoke(cli.app, list(arguments))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, object]]:
    """Nothing is compiled; what would have been is told."""
    calls: list[tuple[str, object]] = []

    def instead(model, platforms=None):
        calls.append((model.identifier, platforms))
        return dict.fromkeys(platforms or [toolchain.host_platform()], b"library")

    monkeypatch.setattr(cli, "compile_model", instead)
    return calls


def test_build_makes_an_fmu_that_validates(tmp_path: Path) -> None:
    code, text = call("build", "xi", "--fmi", "3.0", "--out", str(tmp_path))
    assert code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["xi.fmi3.fmu"]
    assert "xi.fmi3.fmu  FMI 3.0" in text
    code, text = call("validate", str(tmp_path / "xi.fmi3.fmu"))
    assert (code, "no problems found" in text) == (0, True)


def test_build_makes_everything_by_default(quick: list, tmp_path: Path) -> None:
    code, _ = call("build", "--out", str(tmp_path))
    assert code == 0
    names = [model.identifier for model in shipped_models()]
    assert [name for name, _ in quick] == names
    assert len(list(tmp_path.glob("*.fmu"))) == 2 * len(names)


def test_build_makes_an_fmu_for_any_number_of_joints(quick: list, tmp_path: Path) -> None:
    code, _ = call("build", "pd", "--set", "joints=any", "--out", str(tmp_path))
    assert (code, quick) == (0, [("pd_any", None)])
    assert [path.name for path in tmp_path.iterdir()] == ["pd_any.fmi3.fmu"]
    for arguments, reason in (
        (("grasp", "--set", "joints=any"), "grasp has no FMU for any number of joints"),
        (("--set", "joints=any"), "sizes belong to a model"),
        (("pd", "--set", "joints=any", "--set", "x=1"), "joints=any alone"),
    ):
        result = CliRunner().invoke(cli.app, ["build", *arguments, "--out", str(tmp_path)])
        assert reason in str(result.exception)


def test_build_takes_sizes_and_platforms(quick: list, tmp_path: Path) -> None:
    options = ["--set", "neighbours=3", "--platforms", "all", "--out", str(tmp_path)]
    code, text = call("build", "teleoperation", *options)
    assert code == 0
    assert quick == [("teleoperation_n3", toolchain.PLATFORMS)]
    assert "x86_64-windows" in text
    assert (tmp_path / "teleoperation_n3.fmi2.fmu").is_file()


def test_build_takes_a_module_of_the_users_own(
    quick: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_models").mkdir()
    (tmp_path / "my_models" / "link.py").write_text(
        "from dataclasses import replace\nfrom fmus.models import xi\n\n\n"
        "def model():\n    return replace(xi.model(), identifier='mine')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    code, _ = call("build", "my_models.link", "--out", str(tmp_path / "out"))
    assert code == 0
    assert quick == [("mine", None)]


def test_list_names_every_model() -> None:
    code, text = call("list")
    assert code == 0
    for name in SHIPPED:
        assert name in text
    assert "sizes: neighbours" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["build", "nothing"], "no model 'nothing'; expected one of planar2r"),
        (["build", "json.decoder"], "json.decoder has no function model()"),
        (["build", "xi", "--fmi", "4"], "--fmi: '4' is not 2.0, 3.0 or both"),
        (["build", "xi", "--platforms", "amiga"], "--platforms: unknown platform 'amiga'"),
        (["build", "grasp", "--set", "neighbours=2"], "has no size 'neighbours'; it has no sizes"),
        (
            ["build", "xi", "--set", "joints=0"],
            "joints is 0; expected a whole number of at least 1",
        ),
        (["build", "teleoperation", "--set", "n=2"], "has no size 'n'; expected one of neighbours"),
        (["build", "teleoperation", "--set", "neighbours"], "not NAME=INTEGER"),
        (
            ["build", "teleoperation", "--set", "neighbours=-1"],
            "neighbours is -1, expected at least",
        ),
        (["build", "--set", "neighbours=2"], "name it"),
        (["validate", "nowhere.fmu"], "nowhere.fmu: no such file"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sys.argv", ["fmus", *arguments])
    monkeypatch.setattr(cli, "open_standard_streams", lambda: None)  # those of this process stay
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_fmu_with_problems_is_exit_code_1(tmp_path: Path) -> None:
    from zipfile import ZipFile

    broken = tmp_path / "broken.fmu"
    with ZipFile(find(xi.model(), "2.0")) as good, ZipFile(broken, "w") as bad:
        for name in good.namelist():
            content = good.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'unit="rad/s"', b'unit="furlong"')
            bad.writestr(name, content)
    code, text = call("validate", str(broken))
    assert code == 1
    assert "furlong" in text
    assert "problem(s)" in text


def test_a_model_that_fails_to_import_shows_its_own_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "half_made.py").write_text("import not_there_at_all\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "half_made.py").write_text("import not_there_at_all\n")
    with pytest.raises(ModuleNotFoundError, match="not_there_at_all"):
        call("build", "pack.half_made")


def test_build_writes_firmware_and_tells_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "")
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))  # zig is here; no emulator
    code, text = call("build", "xi", "--firmware", "cortex-m4", "--out", str(tmp_path / "xi"))
    assert code == 0, text
    assert "zig cc: text " in text
    assert "not run, since the emulator is not installed" in text
    made = {path.name for path in (tmp_path / "xi").iterdir()}
    assert made == {
        *("xi.c", "xi.h", "check.c", "Makefile", "README.md"),
        *("board.h", "cortex_m.c", "cortex_m.ld", "freestanding.c"),
    }
    page = (tmp_path / "xi" / "README.md").read_text(encoding="utf-8")
    assert "| zig cc | " in page
    assert "`qemu-system-arm` was not installed" in page


def test_build_writes_firmware_of_several_models(tmp_path: Path) -> None:
    words = ["xi", "pd", "--firmware", "generic", "--out", str(tmp_path)]
    assert call("build", *words)[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pd", "xi"]
    assert (tmp_path / "pd" / "pd.c").is_file()


LIBC = '#include <stdlib.h>\n#include "model.h"\n'


def test_firmware_refuses_what_it_cannot_be(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from fmus.model import Model\n"
        "def model():\n"
        f"    return Model('own', 'Own', 'sampled', (), ({str(tmp_path / 'own.c')!r},))\n"
    )
    (tmp_path / "own.c").write_text(LIBC)
    for arguments, reason in (
        (("xi", "--firmware", "cortex-m3"), "'cortex-m3' is not one of cortex-m4, cortex-m7"),
        (("mine:Law", "--firmware", "cortex-m4"), "found the Python class mine:Law, expected a"),
        (("xi", "--firmware", "cortex-m4", "--wasm"), "found --wasm, which is about FMUs"),
        (("xi", "--firmware", "riscv32", "--fmi", "2.0"), "found --fmi, which is about FMUs"),
        (("pd", "--set", "joints=any", "--firmware", "generic"), "found --set joints=any"),
        ((str(own), "--firmware", "generic"), "own: own.c includes <stdlib.h>; expected a file"),
    ):
        result = CliRunner().invoke(cli.app, ["build", *arguments, "--out", str(tmp_path / "out")])
        assert isinstance(result.exception, CosimError)  # exit code 2
        assert reason in str(result.exception)
        assert not (tmp_path / "out").exists()
