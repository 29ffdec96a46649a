"""Command line `myork`: each command parses, calls one function and says where the result lies.

Exit status: 0 done; 1 the run ended without convergence, the last state is written, or its answer
is refused; 2 bad input; 3 a missing or broken part of the installation.
"""

from __future__ import annotations

import argparse
import importlib
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import myork
from myork.bench import BENCHES
from myork.commands import (
    add_rom_commands,
    add_studies,
    add_sweep,
    add_view,
    override,
    overrides_of,
    positive,
)
from myork.console import Console, Unheard
from myork.errors import ConvergenceError, MyorkError
from myork.files import write_text
from myork.libraries import cure_of
from myork.summary import asked

__all__ = ["main"]

_EXIT_STATUS = """\
exit status: 0 done; 1 ended without convergence, the last state is written, or the answer is
refused; 2 bad input; 3 a missing or broken part of the installation"""


#: Commands of two words
_PAIRS = {
    "rom": ("train", "solve", "map", "check"),
    "study": ("sensitivity", "identify", "uncertainty"),
}

_KINDS = "box, annulus, muscle, labels, images, leg or reduced"

#: OpenBLAS does not end where its buffers are refused; `myork-solve` has the same limit
_LEAST_BYTES = 800_000_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after the command name; default those of the process.

    Returns
    -------
    int
        Exit status.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[1:2] and words[1] in _PAIRS.get(words[0], ()):
        # commands of a trained model stand beside `rom DECK`
        words[:2] = [" ".join(words[:2])]
    options = _parser().parse_args(words)
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < _LEAST_BYTES:
        return _complain(
            f"the limit of the memory (ulimit -v) is {limit / 1e6:.0f} MB: at least "
            f"{_LEAST_BYTES / 1e6:.0f} MB are needed",
            2,
        )
    if sys.stdout is sys.__stdout__:
        sys.stdout, sys.stderr = Unheard(sys.stdout), Unheard(sys.stderr)
    # SIGTERM (time limits, schedulers) ends a run as cleanly as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if options.threads is not None:
        # Before numpy and the core are loaded: their thread pools read this once.
        os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = str(options.threads)
    try:
        # interrupted while it loads, numpy calls itself a broken installation: signals wait
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
        try:
            importlib.import_module("numpy")
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        options.run(options)
    except KeyboardInterrupt:
        return _complain("stopped; what was finished is written", 1)
    except Exception as error:
        if options.verbosity > 0:
            traceback.print_exc()
        return _complain(*_explanation(error))
    return 0


def _complain(message: str, status: int) -> int:
    sys.stdout.flush()
    print(f"myork: {message}", file=sys.stderr)
    return status


def _explanation(error: Exception) -> tuple[str, int]:
    """Message and exit status of an exception that ended a command."""
    if isinstance(error, MyorkError):
        return str(error), error.exit_code
    if isinstance(error, ImportError):
        return f"a part of the installation does not load: {error}; {cure_of(str(error))}", 3
    if isinstance(error, OSError):
        return str(error), 2
    name = type(error).__name__
    return f"internal error, please report it with the output of -v: {name}: {error}", 3


def _segment(options: argparse.Namespace) -> None:
    from myork.stations.segment import segment

    print(f"labels and fibers in {_run(segment, options)}")


def _tensors(options: argparse.Namespace) -> None:
    from myork.stations.tensors import write_tensors

    print(f"tensors and fibers in {_run(write_tensors, options)}")


def _build(options: argparse.Namespace) -> None:
    from myork.stations.build import build

    print(f"model in {_run(build, options)}")


def _solve(options: argparse.Namespace) -> None:
    from myork.stations.solve import run_deck

    _run(
        run_deck,
        options,
        verbosity=options.verbosity,
        error=not options.no_error,
        resume=options.resume,
        start=options.start_from,
    )


def _chain(options: argparse.Namespace) -> None:
    from myork.chain import run_chain

    pages: list[Path] = []
    _run(
        lambda deck, out, **keys: pages.append(run_chain(deck, out, **keys)),
        options,
        verbosity=options.verbosity,
        error=not options.no_error,
    )
    print(f"report: {pages[0]}")


def _rom(options: argparse.Namespace) -> None:
    from myork.rom import run_rom

    print(f"reduced models in {_run(run_rom, options)}")


def _run(station: Callable[..., Any], options: argparse.Namespace, **more: Any) -> Path:
    """Run a station on the deck of a command; the folder of its results."""
    # All commands of one deck share it.
    out: Path = options.out or Path("out", options.deck.stem)
    out.mkdir(parents=True, exist_ok=True)
    solves = options.run in (_solve, _chain)
    with asked(out) if solves else nullcontext():
        overrides = overrides_of(options)
    with Console(options.verbosity) as console:
        station(
            options.deck,
            out,
            overrides=overrides,
            threads=options.threads,
            progress=console,
            **more,
        )
    return out


def _bench(options: argparse.Namespace) -> None:
    from myork.bench import run_benches

    out = options.out or Path("out", "bench")
    with Console(options.verbosity) as console:
        record = run_benches(
            options.names,
            out,
            quick=options.quick,
            limit=options.limit,
            resume=options.resume,
            progress=console,
        )
    print(f"benchmarks: {out / 'bench.html'}")
    ended = [name for name, bench in record["benches"].items() if "ended" in bench]
    if ended:
        raise MyorkError(f"without a result: {', '.join(ended)}")


def _report(options: argparse.Namespace) -> None:
    from myork.report import compare_runs, make_report

    if len(options.folders) > 1:
        print(f"report: {compare_runs(options.folders, options.out)}")
        return
    folder = options.folders[0]
    models = sorted(folder.glob("*.rom.h5"))
    if models:
        from myork.view.still import keep_states

        try:
            keep_states(models[0], folder)
        except MyorkError as reason:
            # the run is reported all the same
            print(f"myork: {reason}; the report holds no states of it", file=sys.stderr)
    page = make_report(folder)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        text, page = page.read_text(encoding="utf-8"), options.out / page.name
        write_text(page, text)
    print(f"report: {page}")


def _explain(options: argparse.Namespace) -> None:
    from myork.stations.explain import explain_deck

    explain_deck(options.deck, out=options.out, overrides=overrides_of(options))


def _check(options: argparse.Namespace) -> None:
    from myork.stations.check import check_deck

    found = check_deck(
        options.deck,
        options.out,
        overrides=overrides_of(options),
        quick=options.quick,
        progress=(lambda line: None) if options.verbosity < 0 else print,
    )
    failed = [check.name for check in found if check.passed is False]
    if failed:
        raise ConvergenceError(f"checks that failed: {', '.join(failed)}")


def _selftest(options: argparse.Namespace) -> None:
    from myork.selftest import run_selftest

    found = run_selftest(
        options.out, progress=(lambda line: None) if options.verbosity < 0 else print
    )
    failed = [check.name for check in found if check.passed is False]
    if failed:
        raise ConvergenceError(f"checks that failed: {', '.join(failed)}")


def _new(options: argparse.Namespace) -> None:
    from myork.stations.new import new_deck

    print(f"deck: {new_deck(options.kind, options.output)}")


def _demo(options: argparse.Namespace) -> None:
    from myork.demo import run_demo

    with Console(options.verbosity) as console:
        closing = run_demo(
            options.out or Path("out", "demo"), threads=options.threads, progress=console
        )
    print(closing)


def _folder(text: str) -> Path:
    if not text.strip():
        raise argparse.ArgumentTypeError("the name of a folder is needed; . is the current one")
    return Path(text)


class _Version(argparse.Action):
    """Print the version; it is not looked up before."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        print(f"myork {myork.__version__}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="myork",
        description="From an image to a muscle force and its reduced model.",
        epilog=f"examples:\n  myork demo\n  myork solve --help\n\n{_EXIT_STATUS}",
        formatter_class=raw,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and end")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "--threads", type=positive, metavar="N", help="number of threads; default all cores"
    )
    loudness = common.add_mutually_exclusive_group()
    loudness.add_argument(
        "-q", "--quiet", dest="verbosity", action="store_const", const=-1, help="no progress"
    )
    loudness.add_argument(
        "-v",
        "--verbose",
        dest="verbosity",
        action="store_const",
        const=1,
        help="a line for every iteration, a traceback with an error",
    )
    common.set_defaults(verbosity=0)

    def add(
        name: str, run: Callable[[argparse.Namespace], None], what: str, examples: str, out: str
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(
            name,
            parents=[common],
            help=what,
            description=what[0].upper() + what[1:] + ".",
            epilog=f"examples:\n{examples}\n\n{_EXIT_STATUS}",
            formatter_class=raw,
        )
        command.add_argument("--out", type=_folder, metavar="DIR", help=out)
        command.set_defaults(run=run)
        return command

    def add_deck(
        name: str, run: Callable[[argparse.Namespace], None], what: str, examples: str
    ) -> argparse.ArgumentParser:
        command = add(name, run, what, examples, "folder of the results; default out/<deck>")
        command.add_argument("deck", type=Path, metavar="DECK", help="deck file (TOML)")
        command.add_argument(
            "--set",
            type=override,
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="override a key of the deck, such as load.steps=20 or material.fat.K=5e3; "
            "may be repeated",
        )
        return command

    add(
        "demo",
        _demo,
        "phantom images, segmentation, model, full solution, reduced model and report",
        "  myork demo\n  myork demo --out /tmp/demo --threads 2",
        "folder of the results; default out/demo",
    )
    add(
        "selftest",
        _selftest,
        "checks of the installation in a minute: known answers, threads, files, both programs",
        "  myork selftest\n  myork selftest --out out/selftest",
        "folder that keeps what the checks wrote; default none",
    )
    segment = add_deck(
        "segment",
        _segment,
        "images to label map, fibers and scores",
        "  myork segment inputs/mg_muscle.toml\n"
        "  myork segment inputs/leg_muscles.toml --set image.iterations=300\n"
        "  myork segment inputs/images/thighs.toml --data ~/images",
    )
    tensors = add_deck(
        "tensors",
        _tensors,
        "diffusion images to tensors, their numbers and fibers, without a segmentation",
        "  myork tensors leg.toml\n"
        "  myork tensors leg.toml --set image.dwi=dwi.nii.gz --set image.region=muscles.nii.gz",
    )
    build = add_deck(
        "build",
        _build,
        "labels and fibers to the points of a model (model.h5)",
        "  myork build inputs/mg_muscle.toml\n"
        "  myork build inputs/images/biceps.toml --data ~/images",
    )
    chain = add_deck(
        "run",
        _chain,
        "all that a deck asks for: segment, build, solve and report",
        "  myork run inputs/images/biceps.toml --data ~/images\n"
        "  myork run inputs/mg_muscle.toml --set load.activation=0.2",
    )
    for command in (segment, tensors, build, chain):
        command.add_argument(
            "--data",
            type=_folder,
            metavar="DIR",
            help="where the files that the deck names lie, in any folders of it",
        )
    solve = add_deck(
        "solve",
        _solve,
        "solve the full model of a deck",
        "  myork solve inputs/shear_3d.toml\n"
        "  myork solve inputs/muscle_block.toml --solver refined --threads 2\n"
        "  myork solve inputs/muscle_block.toml --set load.steps=20 --set material.K=1e4\n"
        "  myork solve inputs/muscle_block.toml --set load.steps=20 --resume",
    )
    solve.add_argument("--method", metavar="NAME", help="override scene.method, such as rkcm")
    solve.add_argument(
        "--solver",
        metavar="NAME",
        help="override solver.linear: auto, dgels, dgelsy, normal, refined, spqr, sparse-normal",
    )
    solve.add_argument(
        "--resume",
        action="store_true",
        help="go on from the last whole load step of an earlier run in the folder",
    )
    solve.add_argument(
        "--start-from",
        metavar="FILE[:STEP]",
        help="begin at a state of a result file instead of at rest",
    )
    for command in (solve, chain):
        command.add_argument(
            "--no-error",
            action="store_true",
            help="no second solution, which gives the probes their error bars",
        )
    add_deck(
        "rom",
        _rom,
        "snapshots to reduced models, with errors and timings against the full solution",
        "  myork rom inputs/muscle_block.toml\n"
        "  myork rom inputs/muscle_block.toml --set rom.modes=[1,2,10]",
    )
    add_rom_commands(add, add_deck)
    add_sweep(add_deck)
    add_studies(add)
    add_view(commands.add_parser, common)
    bench = add(
        "bench",
        _bench,
        "the tables and speed-against-error curves of the reference problems, solved anew",
        "  myork bench nonlinear\n  myork bench stability --quick\n"
        "  myork bench nonlinear stability curves mms --out out/bench\n"
        "  myork bench all --quick --limit 300\n  myork bench all --resume",
        "folder of bench.json and bench.html; default out/bench",
    )
    bench.add_argument(
        "names",
        nargs="+",
        metavar="NAME",
        help=f"{', '.join(BENCHES[:-1])} or {BENCHES[-1]}; all for every one",
    )
    bench.add_argument("--quick", action="store_true", help="small cases only")
    bench.add_argument(
        "--limit",
        type=float,
        metavar="SECONDS",
        help="go on with the next benchmark after this time, or when one fails; with all 3600, "
        "600 with --quick",
    )
    bench.add_argument(
        "--resume",
        action="store_true",
        help="keep the results of an earlier run in the folder, run what is missing or had none",
    )
    report = add(
        "report",
        _report,
        "HTML page of an output folder or a sweep, or of several runs side by side",
        "  myork report out/muscle_block\n"
        "  myork report out/muscle_block_sweep\n"
        "  myork report out/coarse out/fine --out out/compared",
        "put a copy of the page there",
    )
    report.add_argument(
        "folders", type=Path, nargs="+", metavar="DIR", help="output folder of a command"
    )
    add_deck(
        "explain",
        _explain,
        "say what a deck will model: sizes, memory and cost; refuse what does not fit",
        "  myork explain inputs/muscle_block.toml",
    )
    check = add_deck(
        "check",
        _check,
        "self-checks of a deck: tangent, materials, fibers, balance, restart, threads",
        "  myork check inputs/muscle_block.toml\n  myork check deck.toml --quick",
    )
    check.add_argument("--quick", action="store_true", help="without those that solve the deck")
    new = commands.add_parser(
        "new",
        help="a commented deck to start from",
        description=f"A commented deck to start from: {_KINDS}.",
        epilog=f"examples:\n  myork new box\n  myork new labels -o leg.toml\n\n{_EXIT_STATUS}",
        formatter_class=raw,
        parents=[common],
    )
    new.add_argument("kind", metavar="KIND", help=_KINDS)
    new.add_argument("-o", "--output", type=Path, metavar="FILE", help="default KIND.toml")
    new.set_defaults(run=_new)
    return parser
