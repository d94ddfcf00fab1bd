"""``cosim completion``: what a shell needs to complete commands, options and files."""

from __future__ import annotations

from typing import Annotated

import typer

#: Commands and files are completed at once; options are read from the help of the command.
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
        COMPREPLY=($(compgen -f -- "$word"))
    fi
}}
complete -o filenames -F _cosim cosim
"""
_FISH = """\
complete -c cosim -n __fish_use_subcommand -f -a "{commands}"
complete -c cosim -n 'not __fish_use_subcommand' -a '(cosim (commandline -opc)[2] --help \
2>/dev/null | string match -rag -- "(--[a-z][a-z-]*)")'
"""
_ZSH = (
    """\
(( $+functions[compdef] )) || {{ autoload -Uz compinit && compinit; }}
autoload -Uz bashcompinit && bashcompinit
"""
    + _BASH
)


def completion(
    shell: Annotated[str, typer.Argument(help="Shell: bash, zsh or fish.")],
) -> None:
    """Print the completion of a shell: eval "$(cosim completion bash)"."""
    from cosim.base.errors import ScenarioError
    from cosim.base.names import unknown
    from cosim.base.parts import commands
    from cosim.cli.overview import COMMANDS

    scripts = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}
    if shell not in scripts:
        raise ScenarioError(unknown(shell, scripts, "completion of the shell"), "cosim completion")
    typer.echo(
        scripts[shell].format(commands=" ".join(dict.fromkeys([*COMMANDS, *commands()]))), nl=False
    )
