"""Command line `myork`: a table of commands, each of which calls one function.

Exit status: 0 done; 1 the run ended without convergence, the last state is written, or its answer
is refused; 2 bad input; 3 a missing or broken part of the installation.
"""

import argparse
import csv
import importlib
import os
import re
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import myork
from myork.bench import BENCHES
from myork.console import Console, say, silent
from myork.errors import ConvergenceError, InputError, MyorkError, cure_of
from myork.files import check_writable, json_text, write_json, write_text
from myork.summary import asked

_EXIT_STATUS = """\
exit status: 0 done; 1 did not converge (the last state is written) or the answer was
refused; 2 bad input; 3 part of the installation is missing or broken"""

_KINDS = "box, annulus, muscle, labels, images, leg or reduced"

#: OpenBLAS does not stop where its buffers are refused; `myork-solve` has the same limit
_LEAST_BYTES = 800_000_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    - `arguments`: words after the command name; default those of the process
    - returns exit status
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if " ".join(words[:2]) in _COMMANDS:
        # commands of a trained model are listed beside `rom DECK`
        words[:2] = [" ".join(words[:2])]
    options = _parser().parse_args(words)
    if options.default_out and options.out is None:
        options.out = Path(re.sub("<.*>", _name_of(options), options.default_out))
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < _LEAST_BYTES:
        return _complain(
            f"the limit of the memory (ulimit -v) is {limit / 1e6:.0f} MB: at least "
            f"{_LEAST_BYTES / 1e6:.0f} MB are needed",
            2,
        )
    # SIGTERM (time limits, schedulers) ends a run as cleanly as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # Before numpy and the core are loaded: their thread pools read this once. For matrices as small
    # as those here, threads of numpy's BLAS wait for each other longer than they compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if options.threads is not None:
        os.environ["OMP_NUM_THREADS"] = str(options.threads)
    try:
        # if interrupted while loading, numpy reports a broken installation: signals wait
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
        try:
            importlib.import_module("numpy")
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        with Console(options.verbosity) as console:
            result = options.run(options, console)
        if result:
            say(result)
    except KeyboardInterrupt:
        status = _complain("stopped; results that were finished are kept", 1)
        if arguments is None:
            # a library that was interrupted while loading may crash when Python unloads it
            os._exit(status)
        return status
    except Exception as error:
        if options.verbosity > 0:
            traceback.print_exc()
        return _complain(*_explanation(error))
    return 0


def _name_of(options: argparse.Namespace) -> str:
    """Name of what a command is given: all commands of one deck or model share a folder."""
    given = next((vars(options)[key] for key in ("deck", "file", "source") if key in options), "")
    path = Path(given)
    return path.resolve().name if path.is_dir() else re.sub(r"(\.rom)?\.\w+$", "", path.name)


def _complain(message: str, status: int) -> int:
    say(f"myork: {message}", error=True)
    return status


def _explanation(error: Exception) -> tuple[str, int]:
    """Message and exit status of an exception that ended a command."""
    if isinstance(error, MyorkError):
        return str(error), error.exit_code
    if isinstance(error, ImportError):
        return f"part of the installation cannot be loaded: {error}; {cure_of(str(error))}", 3
    if isinstance(error, OSError):
        # an exception without errno has only its arguments, which may be a bare path
        what = error.strerror or f"{type(error).__name__}: {error}"
        return f"{error.filename}: {what}" if error.filename else what, 2
    name = type(error).__name__
    return f"internal error, please report it with the output of -v: {name}: {error}", 3


# ---- what commands do: options and console -> what is printed at the end -------------------------

_Run = Callable[[argparse.Namespace, Console], str | None]


def _load(place: str) -> Any:
    """A function by its module below myork and its name."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(f"myork.{module}"), name)


def _call(place: str, says: str, *own: str, **more: str) -> _Run:
    """Command that calls a function with options, by their names; `console` takes its progress."""

    def run(options: argparse.Namespace, console: Console) -> str:
        values = {**vars(options), "console": console}
        keys = {key: values[option] for key, option in more.items()}
        found = _load(place)(*(values[option] for option in own), **keys)
        return says.format(found="\n".join(found) if isinstance(found, list) else found)

    return run


def _station(place: str, says: str = "", **more: str) -> _Run:
    """Command that runs a function of the deck and its folder; `more` are options it takes."""

    def run(options: argparse.Namespace, console: Console) -> str:
        # a mistyped name creates no folder
        if options.deck.exists():
            options.out.mkdir(parents=True, exist_ok=True)
        with asked(options.out) if "verbosity" in more else nullcontext():
            if options.deck.is_dir():
                read = _load("stations.folder:deck_of_folder")
                options.deck, lines = read(options.deck, options.out)
                for line in lines:
                    console(line)
            overrides = _overrides(options)
        found = _load(place)(
            options.deck, options.out, overrides=overrides, threads=options.threads,
            progress=console, **{name: getattr(options, option) for name, option in more.items()},
        )  # fmt: skip
        return says.format(found=found, out=options.out)

    return run


def _overrides(options: argparse.Namespace) -> list[str]:
    """Overrides of the deck: files found by `--data`, options with a name of their own last."""
    found: list[str] = []
    if getattr(options, "data", None) is not None:
        found = _load("stations.data:data_overrides")(options.deck, options.data, options.set)
    keys = {"scene.method": "method", "solver.linear": "solver"}
    named = {key: getattr(options, name, None) for key, name in keys.items()}
    return [*options.set, *found, *(f"{key}={v}" for key, v in named.items() if v is not None)]


def _check(options: argparse.Namespace, console: Console) -> None:
    found = _load("stations.check:check_deck")(
        options.deck, options.out, overrides=options.set, quick=options.quick,
        progress=silent if options.verbosity < 0 else say,
    )  # fmt: skip
    failed = [check.name for check in found if check.passed is False]
    if failed:
        raise ConvergenceError(f"failed checks: {', '.join(failed)}")


def _bench(options: argparse.Namespace, console: Console) -> None:
    run = _load("bench:run_benches")
    record = run(options.names, options.out, quick=options.quick, progress=console)
    say(f"benchmarks: {options.out / 'bench.html'}")
    ended = [name for name, bench in record["benches"].items() if "ended" in bench]
    if ended:
        raise MyorkError(f"no result for {', '.join(ended)}")


def _reproduce(options: argparse.Namespace, console: Console) -> str | None:
    if options.list:
        return str(_load("bench.reproduce:list_tables")())
    if not options.names:
        raise InputError("name a table or figure, such as 6.8, or all; --list prints them")
    content = _load("bench.reproduce:reproduce")(
        options.names, options.out, progress=console,
        show=silent if options.verbosity < 0 else say,
    )  # fmt: skip
    ended = {row["table"] for row in content["rows"] if "ended" in row}
    if ended:
        raise ConvergenceError(f"no number for {', '.join(sorted(ended))}")
    return f"published and ours: {options.out / 'reproduce.html'}"


def _report(options: argparse.Namespace, console: Console) -> str:
    page: Path = _load("report:make_report")(options.folder)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        text, page = page.read_text(encoding="utf-8"), options.out / page.name
        write_text(page, text)
    return f"report: {page}"


def _view(options: argparse.Namespace, console: Console) -> str | None:
    threads = options.threads or 1
    if options.still is not None:
        still = _load("view:still_page")
        return f"page: {still(options.file, options.still, threads=threads, progress=console)}"
    # closing the terminal stops the page like Ctrl-C; under nohup it stays
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    _load("view:serve")(
        options.file, port=options.port, browser=not options.no_browser, threads=threads,
        progress=say,
    )  # fmt: skip
    return None


def _model(options: argparse.Namespace, threads: int | None = None) -> Any:
    """The reduced model of a command."""
    return _load("rom.model:ReducedModel").load(
        options.file, threads=threads or options.threads or 0
    )


def _rom_train(options: argparse.Namespace, console: Console) -> str:
    path = options.output or options.out / f"{options.deck.stem}.rom.h5"
    if options.deck.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        check_writable(path)
    rom = _load("rom.train:train")(
        options.deck, options.vary, tolerance=options.tolerance, full_solves=options.full_solves,
        tests=options.tests, seed=options.seed, out=options.out, overrides=options.set,
        threads=options.threads, progress=console,
    )  # fmt: skip
    rom.save(path)
    return f"{rom.describe()}\nreduced model: {path}"


def _rom_solve(options: argparse.Namespace, console: Console) -> None:
    state = _model(options, threads=1).solve(**_load("rom.parameters:numbers_of")(options.set))
    say(json_text(state.as_dict()) if options.json else state.describe())
    if not state.converged:
        raise ConvergenceError("the reduced model did not converge for these parameters")


def _rom_map(options: argparse.Namespace, console: Console) -> str:
    fixed, out = _load("rom.parameters:numbers_of")(options.set), options.out
    found = _load("rom.map:map_model")(_model(options), options.vary, fixed, out)
    return (
        f"{found['states']} states, {found['failed']} failed, {found['full']['lost']} near full "
        f"solves that are unstable or did not converge, {found['certified']} within the tolerance, "
        f"{found['cpu_us_per_state']:.0f} us each: {out / 'map.csv'}"
    )


def _rom_check(options: argparse.Namespace, console: Console) -> str:
    out, rom = options.out, _model(options)
    found = _load("rom.check:compare")(rom, rom.full_model(), options.points, options.seed, console)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "check.json", found)
    rom.set_certificate(found)
    return f"{rom.describe()}\ncheck: {out / 'check.json'}"


def _sweep(options: argparse.Namespace, console: Console) -> str:
    table: Path = _load("sweeps:sweep")(
        options.deck, options.vary, options.out, samples=options.samples, seed=options.seed,
        workers=options.workers, dask=options.dask, model=options.model, overrides=options.set,
        dry_run=options.dry_run,
        progress=say if options.dry_run else console,
    )  # fmt: skip
    if options.dry_run:
        return ""
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    if all(row["verdict"] in ("failed", "refused") for row in rows):
        raise ConvergenceError(
            f"no point of the sweep has an answer: all {len(rows)} failed or were refused, the "
            f"first because: {rows[0]['message']} (table: {table})"
        )
    return f"table: {table}"


# ---- options -------------------------------------------------------------------------------------


def _override(text: str) -> str:
    """Text KEY=VALUE of an option."""
    key, sign, value = text.partition("=")
    if not (sign and key.strip() and value.strip()):
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE, as in load.steps=20, not {text!r}")
    return text


def _whole(least: int, most: int) -> Callable[[str], int]:
    """Type of an option that is a whole number of a range."""

    def number(text: str) -> int:
        if not (text.strip().isdecimal() and least <= int(text) <= most):
            raise argparse.ArgumentTypeError(f"must be between {least} and {most}, not {text!r}")
        return int(text)

    return number


def _folder(text: str) -> Path:
    if not text.strip():
        raise argparse.ArgumentTypeError("expected the name of a folder; . is the current one")
    return Path(text)


#: Names and settings of an option, as `ArgumentParser.add_argument` takes them
_Option = tuple[list[str], dict[str, Any]]


def _option(names: str, metavar: str, what: str, kind: Any = None, **settings: Any) -> _Option:
    return names.split(), {"metavar": metavar, "help": what, "type": kind, **settings}


def _flag(names: str, what: str, **settings: Any) -> _Option:
    return names.split(), {"help": what, "action": "store_true", **settings}


def _several(names: str, metavar: str, what: str, kind: Any = None, **settings: Any) -> _Option:
    """An option that may be repeated."""
    settings = {"default": None if "required" in settings else [], **settings}
    return _option(names, metavar, f"{what}; may be repeated", kind, action="append", **settings)


def _vary(form: str, what: str) -> _Option:
    return _several("--vary", f"KEY={form}", what, required=True)


def _set(what: str) -> _Option:
    return _several("--set", "KEY=VALUE", what, _override)


def _seed(start: int = 0) -> _Option:
    return _option("--seed", "S", "random seed", int, default=start)


# fmt: off
_THREADS = _whole(1, 1024)
_SET = _set("override a key of the deck, such as load.steps=20 or material.fat.K=5e3")
_DECK = (
    _option(
        "deck", "DECK",
        "deck file (TOML); run, segment and build also accept a folder of images, a BIDS tree or "
        "DICOM, from which a deck is made", Path,
    ),
    _SET,
)
_IMAGES = (
    *_DECK,
    _option("--data", "DIR", "folder that contains the files named in the deck, at any depth",
            _folder),
)
_NO_ERROR = _flag(
    "--no-error", "skip the second solution, and with it the error bars of the probes",
    dest="error", action="store_false",
)
_FILE = _option("file", "FILE", "reduced model (.rom.h5)", Path)
_VALUE = _set("value of a parameter, such as load.activation=0.4")


class _Command(NamedTuple):
    """A command: what it runs, what `--help` says, its options, and what `--out` is."""

    run: _Run
    what: str
    examples: str
    options: tuple[_Option, ...] = ()
    out: str = "folder for the results"  #: Empty where there is no such option
    default: str = "out/<deck>"


_COMMANDS = {
    "demo": _Command(
        _call("demo:run_demo", "{found}", "out", threads="threads", progress="console"),
        "run all steps on phantom images: force, trained reduced model, report, page with sliders",
        "  myork demo\n  myork demo --out /tmp/demo --threads 2",
        default="out/demo",
    ),
    "segment": _Command(
        _station("chain:segment_and_draw", "labels and fibers in {out}"),
        "segment images: label map, fibers, and scores against a reference if there is one",
        "  myork segment inputs/mg_muscle.toml\n"
        "  myork segment inputs/leg_muscles.toml --set image.tolerance=0.01\n"
        "  myork segment inputs/images/thighs.toml --data ~/images",
        _IMAGES,
    ),
    "resample": _Command(
        _call("stations.resample:resample", "image: {found}", "image", "like", "output", way="how",
              progress="console"),
        "interpolate an image, label map, tensors or fibers to the grid of another image",
        "  myork resample mask.nii.gz t1.nii.gz -o mask_on_t1.nii.gz\n"
        "  myork resample fibers.nii.gz t1.nii.gz -o fibers_on_t1.nii.gz --how tensor-wise",
        (
            _option("image", "IMAGE", "image of one or several volumes, or label map", Path),
            _option("like", "LIKE", "image that gives the grid", Path),
            _option("-o --output", "FILE", "file that is written", Path, required=True),
            _option(
                "--how", "WAY",
                "nearest, linear (volume by volume) or tensor-wise (tensors, fibers); default "
                "nearest for labels (non-negative integers, at most 128 different ones), linear "
                "for everything else",
            ),
        ),
        "",
    ),
    "build": _Command(
        _station("stations.build:build", "model in {out}"),
        "make the points of a model (model.h5) from labels and fibers",
        "  myork build inputs/mg_muscle.toml\n"
        "  myork build inputs/images/biceps.toml --data ~/images",
        _IMAGES,
    ),
    "run": _Command(
        _station("chain:run_chain", "report: {found}", verbosity="verbosity", error="error"),
        "run all steps of a deck, from images to the report: segment, build, solve, report",
        "  myork run inputs/images/biceps.toml --data ~/images\n"
        "  myork run inputs/mg_muscle.toml --set load.activation=0.2\n"
        "  myork run study/sub-01\n"
        "  myork run dicom --set image.anatomy=dicom:series=3",
        (*_IMAGES, _NO_ERROR),
    ),
    "solve": _Command(
        _station(
            "stations.solve:run_deck", verbosity="verbosity", error="error", resume="resume",
            start="start_from",
        ),
        "solve the full model of a deck",
        "  myork solve inputs/shear_3d.toml\n"
        "  myork solve inputs/muscle_block.toml --solver refined --threads 2\n"
        "  myork solve inputs/muscle_block.toml --set load.steps=20 --set material.K=1e4\n"
        "  myork solve inputs/muscle_block.toml --set load.steps=20 --resume",
        (
            *_DECK,
            _option("--method", "NAME", "override scene.method, such as rkcm"),
            _option(
                "--solver", "NAME",
                "override solver.linear: auto, dgels, dgelsy, normal, refined, spqr, sparse-normal",
            ),
            _flag(
                "--resume",
                "continue from the last complete load step of an earlier run in the folder",
            ),
            _option(
                "--start-from", "FILE[:STEP]",
                "start from a state in a result file instead of from rest",
            ),
            _NO_ERROR,
        ),
    ),
    "rom": _Command(
        _station("rom:run_rom", "reduced models in {out}"),
        "make reduced models from the states of a solve; errors and times against the full model",
        "  myork rom inputs/muscle_block.toml\n"
        "  myork rom inputs/muscle_block.toml --set rom.modes=[1,2,10]\n"
        "  myork rom train --help    models for any values of parameters; also solve, map, check",
        _DECK,
    ),
    "rom train": _Command(
        _rom_train,
        "train a reduced model of a deck, valid for any values of its parameters in their ranges",
        "  myork rom train inputs/muscle_block.toml --vary load.activation=0:1 \\\n"
        "      --vary boundary.z1.u_z=-0.2:0.3 -o block.rom.h5",
        (
            *_DECK,
            _vary("LOW:HIGH", "parameter with its range, such as load.activation=0:1"),
            _option("-o --output", "FILE", "file to write the model to", Path),
            _option("--tolerance", "TOLERANCE", "target relative error", float, default=1e-3),
            _option("--full-solves", "N", "maximum number of full solves", int, default=60),
            _option("--tests", "N", "additional full solves to test the model", int, default=16),
            _seed(),
        ),
    ),
    "rom solve": _Command(
        _rom_solve,
        "evaluate a reduced model at given parameter values",
        "  myork rom solve block.rom.h5 --set load.activation=0.4 --set u_z=0.1 --json",
        (_FILE, _VALUE, _flag("--json", "print JSON")),
        default="out/<model>",
    ),
    "rom map": _Command(
        _rom_map,
        "evaluate a reduced model on a grid of its parameters and write a table",
        "  myork rom map block.rom.h5 --vary load.activation=0:1:50 --vary u_z=-0.2:0.3:50",
        (
            _FILE,
            _vary("LOW:HIGH:N", "parameter with its range, such as load.activation=0:1:21"),
            _VALUE,
        ),
        default="out/<model>",
    ),
    "rom check": _Command(
        _rom_check,
        "compare a reduced model with full solves at parameter values not used in training",
        "  myork rom check block.rom.h5 --points 20 --out out/block",
        (
            _FILE,
            _option("--points", "N", "number of full solves", _THREADS, default=20),
            _seed(1),
        ),
        default="out/<model>",
    ),
    "sweep": _Command(
        _sweep,
        "solve a deck for many values of its keys, into one table; an interrupted sweep resumes",
        "  myork sweep inputs/muscle_block.toml --vary load.activation=0:1:5 \\\n"
        "      --vary material.muscle.sigma_max=20,30,40 --out out/sweep\n"
        "  myork sweep inputs/muscle_block.toml --vary 'load.activation=lhs(0,1)' --samples 64\n"
        "  myork sweep deck.toml --vary load.activation=0:1:500 --model block.rom.h5",
        (
            *_DECK,
            _vary(
                "...",
                "LOW:HIGH:N for a grid, a,b,c for a list, lhs(LOW,HIGH) for samples",
            ),
            _option("--samples", "N", "number of samples; default 32", int, default=32),
            _seed(),
            _option("--workers", "N", "number of processes; default all cores", _THREADS),
            _option("--dask", "ADDRESS", "address of a Dask scheduler, or local"),
            _option("--model", "FILE", "reduced model (.rom.h5) to use instead of the deck", Path),
            _flag("--dry-run", "print what would be solved and its estimated cost, and exit"),
        ),
        default="out/<deck>_sweep",
    ),
    "view": _Command(
        _view,
        "show a reduced model with sliders: on a local web page until Ctrl-C, or in one HTML file",
        "  myork view out/muscle/muscle.rom.h5\n"
        "  myork view muscle.rom.h5 --no-browser --port 8080\n"
        "  myork view muscle.rom.h5 --still muscle.html",
        (
            _FILE,
            _option(
                "--port", "N", "local port; default a free one", _whole(0, 65535),
                default=0,
            ),
            _flag("--no-browser", "print the address without opening a browser"),
            _option(
                "--still", "PAGE.html",
                "start no server: write a self-contained page of sampled states, interpolated "
                "in between; at most 4 MB of states", Path,
            ),
        ),
        "",
    ),
    "bench": _Command(
        _bench,
        "solve the reference problems again (in a checkout) and write their tables and curves",
        "  myork bench nonlinear\n  myork bench trust --quick\n"
        "  myork bench linear rom --out out/bench\n"
        "  myork bench all --quick",
        (
            _option(
                "names", "NAME", f"{', '.join(BENCHES[:-1])} or {BENCHES[-1]}; all for every one",
                nargs="+",
            ),
            _flag("--quick", "small cases only"),
        ),
        "folder of bench.json and bench.html", "out/bench",
    ),
    "reproduce": _Command(
        _reproduce,
        "compute tables and figures of the dissertation again: published, ours, ratio, CPU time",
        "  myork reproduce --list\n  myork reproduce 6.8 5.2 figure-5.2\n  myork reproduce all",
        (
            _option(
                "names", "NUMBER",
                "6.8, figure-5.2 or all; a bare number is the table, or the figure where there is "
                "no such table", nargs="*",
            ),
            _flag("--list", "list all with their decks and costs, and exit"),
        ),
        "folder of reproduce.json, reproduce.md, reproduce.html and pictures",
        "out/reproduce",
    ),
    "report": _Command(
        _report,
        "write an HTML page about an output folder or a sweep",
        "  myork report out/muscle_block\n"
        "  myork report out/muscle_block_sweep",
        (_option("folder", "DIR", "output folder of a command", Path),),
        "put a copy of the page there", "",
    ),
    "explain": _Command(
        _call("stations.explain:explain_deck", "", "deck", out="out", overrides="set"),
        "print what will be solved: sizes, memory, CPU time; refuse a model too large for memory",
        "  myork explain inputs/muscle_block.toml",
        _DECK,
    ),
    "check": _Command(
        _check,
        "check a deck: tangent, material curves, fibers, balance, restart",
        "  myork check inputs/muscle_block.toml\n  myork check deck.toml --quick",
        (*_DECK, _flag("--quick", "skip the checks that solve the deck")),
        "folder for check.json, where the model file is looked up first", "out/<deck>",
    ),
    "new": _Command(
        _call("stations.new:new_deck", "deck: {found}", "kind", "output"),
        f"write a commented deck to start from: {_KINDS}",
        "  myork new box\n  myork new labels -o leg.toml",
        (
            _option("kind", "KIND", _KINDS),
            _option("-o --output", "FILE", "default KIND.toml", Path),
        ),
        "",
    ),
}
# fmt: on


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="myork",
        description="From images to muscle force and a reduced model.",
        epilog=f"examples:\n  myork demo\n  myork solve --help\n\n{_EXIT_STATUS}",
        formatter_class=raw,
    )
    parser.add_argument(
        "--version", action="version", version=f"myork {myork.__version__}",
        help="print the version and exit",
    )  # fmt: skip
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "-t",
        "--threads",
        type=_THREADS,
        metavar="N",
        help="number of threads; default all cores",
    )
    loudness = common.add_mutually_exclusive_group()
    for names, value, what in (
        (("-q", "--quiet"), -1, "no progress"),
        (("-v", "--verbose"), 1, "a line for every iteration, and a traceback on error"),
    ):
        loudness.add_argument(
            *names, dest="verbosity", action="store_const", const=value, default=0, help=what
        )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, (run, what, examples, options, out, default) in _COMMANDS.items():
        command = commands.add_parser(
            name,
            parents=[common],
            help=what,
            description=what[0].upper() + what[1:] + ".",
            epilog=f"examples:\n{examples}\n\n{_EXIT_STATUS}",
            formatter_class=raw,
        )
        command.set_defaults(run=run, default_out=default if out else "")
        if out:
            place = f"{out}; default {default}" if default else out
            taken = any("-o" in own for own, _ in options)
            short = [] if taken else ["-o"]
            command.add_argument(*short, "--out", type=_folder, metavar="DIR", help=place)
        for own, settings in options:
            given = {key: v for key, v in settings.items() if v is not None}
            command.add_argument(*own, **given)
    return parser
