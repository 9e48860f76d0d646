"""The command `invdyn`: argv -> verb. Imports nothing heavy, so that --help answers at once."""

import io
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module

from invdyn_cli import interruption

VERBS = {
    "run": "run one experiment, or a sweep with -m: data, model, adaptation",
    "check": "check a measured log: defects, their corrections, and what the motion excites",
    "convert": "write an invdyn log of a csv, parquet, npz or mat file, a ROS bag or a LeRobot dataset",
    "diagnose": "find what the simulation gets wrong on a log (-m: of a fleet), the causes, and their gains",
    "excite": "design a trajectory within the joint limits that distinguishes given causes, ready to play",
    "tables": "make the published tables from experiments/*.yaml, with the paper's statements",
    "experiment": "run one of the experiments, or one of your own, and write its table (without a name: list them)",
    "figures": "draw the published figures, and a page that compares all results with the paper",
    "simulate": "write the log of a simulated arm that stands in for the real one, with hidden effects",
    "control": "test a learned model, adapted or not, in the control loop of the simulated arm",
    "compare": "set finished runs of one robot beside each other, as a table and as a page",
    "collect": "put all runs below folders into one table: options that differ, scores, times",
    "report": "draw the figures and the page of a run again, from its run.h5",
    "effects": "list the physical effects that a diagnosis looks for, or tell all about one of them",
    "models": "list the models and adaptations, or tell all about one of them",
    "completion": "print a script that completes this command line in bash, zsh or fish",
}
UNCONFIGURED = ("experiment", "effects", "models", "completion")
"""Verbs without a config in conf/: they take plain words."""

HELP = """invdyn: learn, adapt and compare inverse dynamics models tau = f(q, qd, qdd)

usage: invdyn VERB [option=value ...]

{verbs}

  invdyn run model=ffnn data=sim_noisy                one experiment
  invdyn run -m model=pest,ffnn seed=0,1,2            a sweep
  invdyn collect outputs/sweeps output=runs.csv       all their runs in one table
  invdyn run data=real_log data.path=log.h5 robot=urdf robot.path=arm.urdf model=pest
  invdyn convert bag/ log.h5                          also log.csv, log.npz, log.mat, log.parquet, log.mcap
  invdyn compare outputs/latest OTHER_RUN             scores, parameters and residuals beside each other
  invdyn diagnose data=real_log data.path=log.h5 robot=urdf robot.path=arm.urdf
  invdyn excite robot=urdf robot.path=arm.urdf diagnosis=FOLDER/diagnosis.json
  invdyn control model=pest_friction adaptation=payload
  invdyn run --help                                   all options of a verb
  invdyn effects coulomb_friction                     its equation, parameters, units, and how to distinguish it
  invdyn --version

Exit code: 0; 1 where a check failed under strict=true; 2 for wrong use or where a job of a sweep failed; 3 for an
internal error of invdyn; 130 after Ctrl-C.
"""


def entry() -> None:
    """The installed command: `main` on sys.argv; it ends without a crash even if stdout is closed."""
    interruption.watch()
    code = 0
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # libraries' words to programmers; `python -W` shows them
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that knows ASCII only shows "?" for what it lacks
    try:
        code = main()
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        code = interruption.closed_pipe()
    except BaseException:  # Ctrl-C in the middle of an import or of a config ends in any exception
        if not interruption.was_asked():
            raise
    if interruption.was_asked():
        interruption.end()
    interruption.ignore()
    sys.exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code, as HELP says."""
    argv = list(sys.argv[1:] if argv is None else argv)
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(HELP.format(verbs="\n".join(f"  {name:<10} {said}" for name, said in VERBS.items())), end="")
        return 0
    if argv[0] == "--version":
        from importlib.metadata import version

        print(f"invdyn {version('invdyn')}")
        return 0
    verb, *rest = argv
    if verb not in VERBS:
        from invdyn_cli.errors import closest, listed

        print(f"invdyn: no verb {verb!r}; allowed: {listed(VERBS)}{closest(verb, VERBS)}", file=sys.stderr)
        return 2
    if any(a.startswith(("-sc", "--shell-completion")) for a in rest):
        print(f"invdyn: {verb} has no shell completion of its own. Try: invdyn completion bash", file=sys.stderr)
        return 2
    if {"-h", "--help"} & set(rest) and verb not in UNCONFIGURED:
        return import_module("invdyn_cli.verbs.usage").show(verb, rest)
    return import_module(f"invdyn_cli.verbs.{verb}").main(rest)
