"""All commands as one program, and ``cosim completion``: what a shell needs to complete them."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, final

import typer
from typer.core import TyperOption
from typer.main import get_command

from cosim.base.errors import ScenarioError
from cosim.base.names import hint, unknown
from cosim.base.parts import commands
from cosim.base.python import add_working_directory
from cosim.cli.ending import ProgramGroup, run_program
from cosim.cli.options import flat
from cosim.cli.overview import ALIASES, COMMANDS, overview
from cosim.loading import file_kinds

#: Options of commands that are no longer there, as they were typed, and what serves instead.
REMOVED = {
    "run": {
        "--estimate-error": 'algorithm = "adaptive" keeps the error of a step below a tolerance',
        "--tolerance TEXT": 'algorithm = "adaptive" has run.adaptive.tolerance',
    },
    "analyze": {"--no-plot": "figures are drawn with --png only"},
    "monitor": {"--plotjuggler TEXT": "PlotJuggler opens the file that --mcap FILE writes"},
}
#: Completion by a shell: commands and files at once; options are read from a command's help.
_BASH = """\
_cosim() {{
    local word=${{COMP_WORDS[COMP_CWORD]}}
    if [ "$COMP_CWORD" = 1 ]; then
        COMPREPLY=($(compgen -W "{commands}" -- "$word"))
    elif [[ $word == -* ]]; then
        local options
        options=$(cosim "${{COMP_WORDS[1]}}" --help 2>/dev/null | grep -oE -- '--[a-z][a-z-]*')
        COMPREPLY=($(compgen -W "$options" -- "$word"))
    else
        local found
        case "${{COMP_WORDS[COMP_CWORD-1]}}" in
            --deploy|--set|--record|delays)
                found=$(cosim completion words "${{COMP_WORDS[@]:1:COMP_CWORD}}" 2>/dev/null)
                [[ $found == *= ]] && compopt -o nospace 2>/dev/null;;
        esac
        COMPREPLY=($(compgen -W "$found" -- "$word"))
        [ -n "$found" ] || COMPREPLY=($(compgen -f -- "$word"))
    fi
}}
complete -o filenames -F _cosim cosim
"""
_FISH = """\
complete -c cosim -n __fish_use_subcommand -f -a "{commands}"
complete -c cosim -n 'not __fish_use_subcommand' -a '(cosim (commandline -opc)[2] --help \
2>/dev/null | string match -rag -- "(--[a-z][a-z-]*)")'
complete -c cosim -n 'not __fish_use_subcommand' -a '(cosim completion words \
(commandline -opc)[2..] (commandline -ct) 2>/dev/null)'
"""
_ZSH = (
    """\
(( $+functions[compdef] )) || {{ autoload -Uz compinit && compinit; }}
autoload -Uz bashcompinit && bashcompinit
"""
    + _BASH
)
_SETTINGS = {"help_option_names": ["-h", "--help"]}


@final
class _Commands(ProgramGroup):
    """Commands that are imported when they are called: a list of them needs none."""

    def list_commands(self, ctx: Any) -> list[str]:
        """All names."""
        return [*COMMANDS, *(name for name in commands() if name not in COMMANDS)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, or None."""
        known = self.list_commands(ctx) if cmd_name not in COMMANDS else COMMANDS
        if cmd_name not in known:
            if kind := file_kinds.use(Path(cmd_name)):
                ctx.fail(f"no command: {cmd_name} {kind}")
            if found := hint(cmd_name, known):
                ctx.fail(f"no command {cmd_name!r}{found}")
            return None
        alone = typer.Typer(
            add_completion=False,
            pretty_exceptions_enable=False,
            rich_markup_mode=None,
            context_settings=_SETTINGS,
        )
        words = {"ignore_unknown_options": True} if cmd_name == "completion" else {}
        alone.command(cmd_name, context_settings={**_SETTINGS, **words})(flat(function(cmd_name)))
        one = get_command(alone)
        one.params += [_removed(*option) for option in REMOVED.get(cmd_name, {}).items()]
        return one

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the first of `args` names, also by an earlier name, and the others.

        ``delays from`` is the command ``delays-from``, in words.
        """
        if args[:2] == ["delays", "from"]:
            _, command, rest = super().resolve_command(ctx, ["delays-from", *args[2:]])
            return "delays from", command, rest
        return super().resolve_command(ctx, [*ALIASES.get(args[0], args[:1]), *args[1:]])

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The help of the program."""
        formatter.write(overview())


def _removed(typed: str, instead: str) -> TyperOption:
    """An option that is hidden, and refused with what serves instead."""
    name, _, value = typed.partition(" ")

    def refuse(_context: object, _option: object, value: object) -> None:
        if value:
            raise ScenarioError(f"found {name}, which is no longer there; {instead}")

    return TyperOption(
        param_decls=[name], is_flag=not value, hidden=True, expose_value=False, callback=refuse
    )


def function(name: str) -> Any:
    """The function of a command: of the module of this name beside this one, or an entry point."""
    place = f"cosim.cli.{name}"
    if find_spec(place):
        return getattr(import_module(place), name)
    return commands()[name].load()


def completion(
    shell: Annotated[str, typer.Argument(help="Shell: bash, zsh or fish.")],
    typed: Annotated[
        list[str] | None, typer.Argument(hidden=True, help="Of `words`: the words to complete.")
    ] = None,
) -> None:
    """Print the completion of a shell: eval "$(cosim completion bash)"."""
    if shell == "words":
        from cosim.loading.candidates import candidates

        typer.echo("".join(f"{word}\n" for word in candidates(typed or [])), nl=False)
        return
    scripts = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}
    if shell not in scripts:
        raise ScenarioError(unknown(shell, scripts, "completion of the shell"), "cosim completion")
    typer.echo(
        scripts[shell].format(commands=" ".join(dict.fromkeys([*COMMANDS, *commands()]))), nl=False
    )


app = typer.Typer(
    name="cosim",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=_SETTINGS,
)


def _version(wanted: bool) -> None:
    if wanted:
        from cosim import __version__

        typer.echo(f"cosim {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    """Co-simulation of controllers and FMU plants over links with real latency."""


def command() -> None:
    """The command in this process."""
    add_working_directory()
    run_program(app)
