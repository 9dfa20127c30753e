"""``pica completion``: a script that lets a shell complete commands, options and their choices.

The script holds all words, so that completing starts no Python. Options of a command whose extra is
not installed are not known here: install it, and make the script again.
"""

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from tyro.conf import Positional

from pica_command.catalogue import commands, options_type_of, spoken, summary
from pica_command.settings import settings_of

COMMON_FLAGS = ("--help", "--json", "--debug", "--print-config")


@dataclass(frozen=True, kw_only=True, slots=True)
class CompletionOptions:
    """Options of `pica completion`."""

    shell: Positional[Literal["bash", "zsh", "fish"]]
    """For which shell: `pica completion bash > ~/.local/share/bash-completion/completions/pica`;
    for fish into ~/.config/fish/completions/pica.fish; zsh reads it with `source`."""


def completion(options: CompletionOptions) -> dict[str, Any]:
    """Print a script that completes commands and options in your shell."""
    words = {name.replace(".", " "): _flags(name) for name in commands()}
    script = _fish(words) if options.shell == "fish" else _bash(words)
    if options.shell == "zsh":
        script = f"autoload -Uz compinit bashcompinit && compinit && bashcompinit\n{script}"
    print(script, end="")
    return {"shell": options.shell, "commands": len(words)}


def _flags(name: str) -> dict[str, tuple[str, ...]]:
    """Every flag of a command with the words that may follow it; none where any may."""
    flags: dict[str, tuple[str, ...]] = dict.fromkeys(COMMON_FLAGS, ())
    try:
        options_type = options_type_of(commands()[name])
    except ModuleNotFoundError:  # its extra is missing
        return flags
    if getattr(options_type, "OWN_FILE", False):
        flags["--config"] = ()
    for setting in settings_of(options_type):
        is_literal = get_origin(setting.kind) is Literal
        flags[setting.flag] = tuple(map(str, get_args(setting.kind))) if is_literal else ()
        if setting.kind is bool and not setting.is_switch:
            flags[setting.flag] = ("True", "False")
        elif setting.is_switch:
            flags[setting.negation] = ()
    return flags


def _next_words(names: Iterable[str]) -> dict[str, list[str]]:
    """What may follow ``pica`` and each family of commands, by the words before it."""
    following: dict[str, set[str]] = {"": set()}
    for name in names:
        first, _, second = name.partition(" ")
        following[""].add(first)
        if second:
            following.setdefault(first, set()).add(second)
    return {before: sorted(words) for before, words in following.items()}


def _bash(words: Mapping[str, Mapping[str, tuple[str, ...]]]) -> str:
    cases = [
        f"    {shlex.quote(before)}) reply={shlex.quote(' '.join(after))} ;;"
        for before, after in _next_words(words).items()
    ]
    cases += [
        f"    {shlex.quote(name)}) reply={shlex.quote(' '.join(flags))} ;;"
        for name, flags in words.items()
    ]
    choices = [
        f"    {shlex.quote(f'{name} {flag}')}) reply={shlex.quote(' '.join(allowed))} ;;"
        for name, flags in words.items()
        for flag, allowed in flags.items()
        if allowed
    ]
    lines = "\n".join
    return f"""# Completion of pica for bash; made by `pica completion`.
_pica() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" previous="${{COMP_WORDS[COMP_CWORD-1]}}"
  local name="" word reply=""
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    case "$word" in -*) break ;; esac
    case " {" ".join(first for first in _next_words(words) if first)} " in
      *" $name "*) ;;
      *) [ -n "$name" ] && break ;;
    esac
    name="${{name:+$name }}$word"
  done
  case "$name $previous" in
{lines(choices)}
  esac
  [ -n "$reply" ] || case "$name" in
{lines(cases)}
  esac
  COMPREPLY=($(compgen -W "$reply" -- "$current"))
}}
complete -o default -F _pica pica
"""


def _fish(words: Mapping[str, Mapping[str, tuple[str, ...]]]) -> str:
    known = commands()
    lines = ["# Completion of pica for fish; made by `pica completion`.", "complete -c pica -f"]
    for before, after in _next_words(words).items():
        condition = (
            f"__fish_seen_subcommand_from {before}; and test (count (commandline -opc)) -eq 2"
            if before
            else "__fish_use_subcommand"
        )
        for word in after:
            entry = known.get(f"{before}.{word}".lstrip("."))
            told = summary(entry) if entry is not None else f"see {spoken(word)} --help"
            lines.append(
                f"complete -c pica -n {_fish_quote(condition)} -a {word} -d {_fish_quote(told)}"
            )
    for name, flags in words.items():
        condition = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in name.split())
        for flag, allowed in flags.items():
            values = f" -x -a {_fish_quote(' '.join(allowed))}" if allowed else ""
            lines.append(
                f"complete -c pica -n {_fish_quote(condition)} -l {flag.removeprefix('--')}{values}"
            )
    return "\n".join([*lines, ""])


def _fish_quote(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
