"""invdyn completion SHELL: a script that completes verbs, groups, choices, options and files in bash, zsh and fish.

Hydra's own completion (`--shell-completion`) cannot: it asks `invdyn -sc query=bash`, without the verb, whose config it
would need. The scripts here ask `invdyn completion candidates WORD …` instead, and complete files where that is silent.
"""

from collections.abc import Iterable, Sequence

from invdyn_cli.errors import UsageError, listed

BASH = r"""# bash completion of invdyn: source <(invdyn completion bash), best in ~/.bashrc
_invdyn() {
    local line=${COMP_LINE:0:COMP_POINT} fragment=${COMP_WORDS[COMP_CWORD]} word kept found
    local -a words
    read -ra words <<< "$line"
    [[ $line == *[[:space:]] ]] && words+=("")
    word=${words[${#words[@]}-1]}
    [[ $fragment == [=:@]* ]] && fragment=${fragment#?}
    kept=${word%"$fragment"}  # bash itself keeps what stands before the last = or :
    mapfile -t found < <("${COMP_WORDS[0]}" completion candidates "${words[@]:1}" 2>/dev/null)
    COMPREPLY=()
    if (( ${#found[@]} == 0 )); then
        [[ $word == *=* || ${words[1]} == report || ${words[1]} == convert ]] || return
        compopt -o filenames
        mapfile -t COMPREPLY < <(compgen -f -- "$fragment")
        return
    fi
    compopt -o nospace
    local one
    for one in "${found[@]}"; do
        one=${one#"$kept"}
        [[ $one == *[=.] ]] || one+=" "
        COMPREPLY+=("$one")
    done
}
complete -F _invdyn invdyn
"""

ZSH = r"""#compdef invdyn
# zsh completion of invdyn: source <(invdyn completion zsh) after compinit, best in ~/.zshrc
_invdyn() {
    local -a found
    found=("${(@f)$("${words[1]}" completion candidates "${(@)words[2,CURRENT]}" 2>/dev/null)}")
    found=(${found:#})
    if (( ${#found} == 0 )); then
        compset -P '*='
        _files
        return
    fi
    compadd -Q -S '' -- ${(M)found:#*[=.]}
    compadd -Q -- ${found:#*[=.]}
}
compdef _invdyn invdyn
"""

FISH = r"""# fish completion of invdyn: invdyn completion fish > ~/.config/fish/completions/invdyn.fish
function __invdyn_candidates
    set -l words (commandline -opc)
    set -l current (commandline -ct)
    set -l found ($words[1] completion candidates $words[2..-1] "$current" 2>/dev/null)
    if test (count $found) -gt 0
        printf '%s\n' $found
        return
    end
    set -l key (string match -r '^.*=' -- "$current")
    for file in (__fish_complete_path (string replace -r '^.*=' '' -- "$current"))
        printf '%s%s\n' "$key" $file
    end
end
complete -c invdyn -f -a '(__invdyn_candidates)'
"""

SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH}

HELP = """invdyn completion: print a script that completes invdyn's command line

usage: invdyn completion bash|zsh|fish

  source <(invdyn completion bash)                                        bash: in ~/.bashrc
  source <(invdyn completion zsh)                                         zsh: in ~/.zshrc
  invdyn completion fish > ~/.config/fish/completions/invdyn.fish         fish
"""

FLAGS = ("--help", "--multirun", "--cfg")
HYDRA = ("hydra.run.dir=", "hydra.sweep.dir=", "hydra/launcher=")


def main(argv: Sequence[str]) -> int:
    """Print the script of a shell, or the candidates for the last of some words; the exit code."""
    if argv and argv[0] == "candidates":
        try:
            print("".join(f"{one}\n" for one in dict.fromkeys(candidates(argv[1:]))), end="")
        except Exception:  # whatever is wrong with a half-typed command, a shell waits for an answer
            return 0
        return 0
    if argv and {"-h", "--help"} & set(argv):
        print(HELP, end="")
        return 0
    if len(argv) != 1 or argv[0] not in SCRIPTS:
        from invdyn_cli.verbs.launch import complain

        return complain(f"completion {' '.join(argv)}; allowed: {listed(SCRIPTS)}. Try: invdyn completion bash")
    print(SCRIPTS[argv[0]], end="")
    return 0


def verbs() -> list[str]:
    """All verbs: those with a config, and those that take plain words."""
    from invdyn_cli.verbs.launch import config_folder

    plain = ["effects", "models", "completion", "experiment"]
    return sorted([*plain, *(path.stem for path in config_folder().glob("*.yaml"))])


def candidates(words: Sequence[str]) -> list[str]:
    """The candidates for the last word, if the verb is the first; [] for a file name."""
    verb, current = words[0] if words else "", words[-1] if words else ""
    if len(words) < 2:
        return _beginning([*verbs(), "--help", "--version"], current)
    if verb == "completion":
        return _beginning(SCRIPTS, current)
    if verb in ("effects", "models"):
        from invdyn_cli.verbs import effects, models

        return _beginning(effects.names() if verb == "effects" else models.names(), current)
    if verb == "experiment":
        return _of_experiment(words[1:-1], current)
    if verb not in verbs():
        return []
    return _of_config(verb, [x for x in words[1:-1] if "=" in x and not x.startswith("-")], current)


def _of_experiment(words: Sequence[str], current: str) -> list[str]:
    """Names of experiments, and behind one the options of its class; those of a sweep are those of `tables`."""
    from invdyn_cli.verbs import experiment, listing

    if not words:
        return _beginning(listing.names(), current)
    try:
        spec = listing.read(words[0].replace("-", "_"))
    except UsageError:
        return []
    if "_target_" not in spec:
        return _of_config("tables", [], current)
    return _beginning([f"{name}=" for name in experiment.usual(spec)], current)


def _of_config(verb: str, overrides: Sequence[str], current: str) -> list[str]:
    """Options, groups and their values."""
    from invdyn_cli.verbs import options

    try:
        found = options.described(verb, overrides)
    except Exception:  # one of the words before is wrong, or a sweep
        found = options.described(verb)
    key, equals, value = current.partition("=")
    if not equals:
        names = [f"{name}=" for name in (*found.chosen, *(one.name for one in found.options))]
        return [*_to_next_dot(names, current), *_beginning((*HYDRA, *FLAGS) if current else (), current)]
    before, comma, last = value.rpartition(",")  # values of a sweep
    values: Iterable[str] = ()
    if key in found.chosen:
        values = options.choices_of(key.partition("@")[0])
    elif any(one.name == key and one.value in ("true", "false") for one in found.options):
        values = ("true", "false")
    elif (verb, key) == ("tables", "experiment"):
        values = sorted(path.stem for path in options.config_folder().with_name("experiments").glob("*.yaml"))
    return [f"{key}={before}{comma}{x}" for x in _beginning(values, last)]


def _to_next_dot(names: Iterable[str], current: str) -> list[str]:
    """Names with this beginning, each up to its next dot: "data." stands for all options of the data."""
    found = []
    for name in _beginning(names, current):
        at = name.find(".", len(current))
        found.append(name[: at + 1] if at >= 0 else name)
    return list(dict.fromkeys(found))


def _beginning(names: Iterable[str], start: str) -> list[str]:
    return [name for name in names if name.startswith(start)]
