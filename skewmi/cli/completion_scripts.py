"""Completion scripts from what may be typed after each command."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from skewmi.cli.completion_words import Entry

_BASH = """\
# Completion of skewmi for bash{also}; made by `skewmi completion`.
_skewmi() {{
    local cur prev path words flags value files word i
    cur="${{COMP_WORDS[COMP_CWORD]}}"
    prev=""
    [ "$COMP_CWORD" -gt 0 ] && prev="${{COMP_WORDS[COMP_CWORD-1]}}"
    path=""
    i=1
    while [ "$i" -lt "$COMP_CWORD" ]; do
        word="${{COMP_WORDS[i]}}"
        case "$path/$word" in
            {paths}) path="$path/$word" ;;
        esac
        i=$((i+1))
    done
    words="" flags="" value="" files=""
    case "$path" in
{entries}
    esac
    case "$path $prev" in
{values}
    esac
    COMPREPLY=()
    if [ "$value" = "file" ]; then
        COMPREPLY=( $(compgen -f -- "$cur") )
    elif [ "$value" = "any" ]; then
        :
    elif [ -n "$value" ]; then
        COMPREPLY=( $(compgen -W "$value" -- "$cur") )
    else
        case "$cur" in
            -*) COMPREPLY=( $(compgen -W "$flags" -- "$cur") ) ;;
            *)
                COMPREPLY=( $(compgen -W "$words" -- "$cur") )
                [ -n "$files" ] && COMPREPLY+=( $(compgen -f -- "$cur") )
                ;;
        esac
    fi
    return 0
}}
complete -o filenames -F _skewmi skewmi
"""

_ZSH = """\
autoload -U +X compinit && compinit -u -D
autoload -U +X bashcompinit && bashcompinit
"""


def bash_script(entries: Sequence[Entry]) -> str:
    """For bash."""
    return _bash(entries, "")


def zsh_script(entries: Sequence[Entry]) -> str:
    """For zsh, which reads bash's completions."""
    return _ZSH + _bash(entries, " and zsh")


def _bash(entries: Sequence[Entry], also: str) -> str:
    """All names are plain words: nothing of them is expanded by a shell."""
    paths = ["/" + "/".join(entry.command) for entry in entries if entry.command]
    cases, values = [], []
    for entry in entries:
        path = "".join(f"/{word}" for word in entry.command)
        flags = " ".join(name for flag in entry.flags for name in flag.names)
        files = "yes" if entry.takes_path else ""
        words = " ".join(entry.words)
        cases.append(f'        "{path}") words="{words}" flags="{flags}" files="{files}" ;;')
        for flag in entry.flags:
            if not flag.takes_value:
                continue
            value = "file" if flag.takes_path else "any"
            value = " ".join(flag.values) or value
            names = "|".join(f'"{path} {name}"' for name in flag.names)
            values.append(f'        {names}) value="{value}" ;;')
    return _BASH.format(
        also=also,
        paths="|".join(f'"{path}"' for path in paths),
        entries="\n".join(cases),
        values="\n".join(values),
    )


_FISH = """\
# Completion of skewmi for fish; made by `skewmi completion`.
function __skewmi_at
    set -l path
    for word in (commandline -opc)[2..-1]
        contains -- (string join / $path $word) $argv[2..-1]; and set -a path $word
    end
    set -l now (string join / $path)
    test "$now" = "$argv[1]"
end
complete -c skewmi -f
"""


def fish_script(entries: Sequence[Entry]) -> str:
    """For fish."""
    paths = " ".join("/".join(entry.command) for entry in entries if entry.command)
    helps = {"/".join(entry.command): entry.help for entry in entries}
    lines = [_FISH]
    for entry in entries:
        path = "/".join(entry.command)
        at = shlex.quote(f"__skewmi_at {shlex.quote(path)} {paths}")
        start = f"complete -c skewmi -n {at}"
        for word in entry.words:
            told = helps.get(f"{path}/{word}".strip("/"), "")
            lines.append(f"{start} -a {shlex.quote(word)} -d {shlex.quote(told)}\n")
        if entry.takes_path:
            lines.append(f"{start} -F\n")
        for flag in entry.flags:
            names = " ".join(f"-l {name.removeprefix('--')}" for name in flag.names)
            line = f"{start} {names} -d {shlex.quote(flag.help)}"
            if flag.values:
                line += f" -xa {shlex.quote(' '.join(flag.values))}"
            elif flag.takes_path:
                line += " -rF"
            elif flag.takes_value:
                line += " -x"
            lines.append(line + "\n")
    return "".join(lines)
