"""Commands of reduced models and sweeps, and what commands share."""

from __future__ import annotations

import argparse
import json
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from myork.console import Console
from myork.errors import ConvergenceError, InputError

__all__ = [
    "add_rom_commands",
    "add_studies",
    "add_sweep",
    "add_view",
    "override",
    "overrides_of",
    "positive",
]


def overrides_of(options: argparse.Namespace) -> list[str]:
    """Overrides of the deck: files found by `--data`, options with a name of their own last."""
    found: list[str] = []
    if getattr(options, "data", None) is not None:
        from myork.stations.data import data_overrides

        found = data_overrides(options.deck, options.data, options.set)
    named = {
        "scene.method": getattr(options, "method", None),
        "solver.linear": getattr(options, "solver", None),
    }
    return (
        options.set
        + found
        + [f"{key}={value}" for key, value in named.items() if value is not None]
    )


def positive(text: str) -> int:
    """Whole number of an option, from 1 to 1024."""
    try:
        number = int(text)
    except ValueError:
        number = 0
    if not 1 <= number <= 1024:
        raise argparse.ArgumentTypeError(f"at least 1 and at most 1024 are possible, not {text!r}")
    return number


def override(text: str) -> str:
    """Text KEY=VALUE of an option."""
    key, sign, value = text.partition("=")
    if not (sign and key.strip() and value.strip()):
        raise argparse.ArgumentTypeError(f"KEY=VALUE is needed, as in load.steps=20, not {text!r}")
    return text


def _rom_train(options: argparse.Namespace) -> None:
    from myork.rom.model import ReducedModel

    folder = options.out or Path("out", options.deck.stem)
    path = options.output or folder / f"{options.deck.stem}.rom.h5"
    with Console(options.verbosity) as console:
        rom = ReducedModel.train(
            options.deck,
            options.vary,
            tolerance=options.tolerance,
            full_solves=options.full_solves,
            tests=options.tests,
            snapshots=options.snapshots,
            seed=options.seed,
            out=folder,
            overrides=overrides_of(options),
            threads=options.threads,
            progress=console,
        )
    rom.save(path)
    print(rom.describe())
    print(f"reduced model: {path}")


def _rom_solve(options: argparse.Namespace) -> None:
    from myork.rom.model import ReducedModel

    rom = ReducedModel.load(options.file, threads=1)
    state = rom.state(_numbers(options.set))
    print(json.dumps(state.as_dict()) if options.json else state.describe())
    if not state.converged:
        raise ConvergenceError("the reduced model found no state for these parameters")


def _rom_map(options: argparse.Namespace) -> None:
    from myork.rom.map import map_model
    from myork.rom.model import ReducedModel

    out = options.out or Path("out", options.file.name.split(".")[0])
    rom = ReducedModel.load(options.file, threads=options.threads or 0)
    found = map_model(rom, options.vary, _numbers(options.set), out)
    print(
        f"{found['states']} states, {found['failed']} failed, {found['cpu_us_per_state']:.0f} us "
        f"each: {out / 'map.csv'}, {out / 'map.png'}"
    )


def _rom_check(options: argparse.Namespace) -> None:
    from myork.files import write_json
    from myork.rom.check import compare
    from myork.rom.model import ReducedModel
    from myork.rom.parameters import parse_vary

    out = options.out or Path("out", options.file.name.split(".")[0])
    rom = ReducedModel.load(options.file, threads=options.threads or 0)
    fixed = {key: (value, value) for key, value in _numbers(options.set).items()}
    ranges = parse_vary(options.vary) | fixed
    with Console(options.verbosity) as console:
        found = compare(rom, rom.full_model(), options.points, options.seed, console, ranges)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "check.json", found)
    rom.set_certificate(found)
    print(rom.describe())
    print(f"check: {out / 'check.json'}")


def _sweep(options: argparse.Namespace) -> None:
    from myork.sweeps import sweep

    with Console(options.verbosity) as console:
        table = sweep(
            options.deck,
            options.vary,
            options.out or Path("out", f"{options.deck.stem}_sweep"),
            samples=options.samples,
            seed=options.seed,
            workers=options.workers,
            dask=options.dask,
            model=options.model,
            overrides=overrides_of(options),
            dry_run=options.dry_run,
            part=options.part,
            slurm=options.slurm,
            progress=print if options.dry_run or options.slurm else console,
        )
    if options.slurm is not None:
        print(f"script: {table}")
    elif not options.dry_run:
        print(f"table: {table}")


def _view(options: argparse.Namespace) -> None:
    from myork.view import serve

    # a closed terminal ends the page as Ctrl-C does; under nohup it stays
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    serve(
        options.file,
        port=options.port,
        browser=not options.no_browser,
        threads=options.threads or 1,
        progress=_flushed,
    )


def _flushed(line: str) -> None:
    """Print a line at once, also into a pipe."""
    print(line, flush=True)


def _port(text: str) -> int:
    """Port of an option."""
    if not (text.isdecimal() and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"a number from 0 to 65535 is needed, not {text!r}")
    return int(text)


def _numbers(items: Sequence[str]) -> dict[str, float]:
    """Values of `--set KEY=VALUE` that are numbers."""
    found = {}
    for item in items:
        key, _, value = item.partition("=")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            raise InputError(f"--set {item}: a number is needed") from None
    return found


def add_sweep(add_deck: Callable[..., argparse.ArgumentParser]) -> None:
    """The command of many answers; its --out is that of the sweep, not of the deck."""
    command = add_deck(
        "sweep",
        _sweep,
        "solve a deck at many values of its keys: one table, resumed where it ended",
        "  myork sweep inputs/muscle_block.toml --vary load.activation=0:1:5 \\\n"
        "      --vary material.muscle.sigma_max=20,30,40 --out out/sweep\n"
        "  myork sweep inputs/muscle_block.toml --vary 'load.activation=lhs(0,1)' --samples 64\n"
        "  myork sweep deck.toml --vary load.activation=0:1:500 --model block.rom.h5",
    )
    command.add_argument(
        "--vary",
        action="append",
        required=True,
        metavar="KEY=...",
        help="LOW:HIGH:N for a grid, a,b,c for a list, lhs(LOW,HIGH) or sobol(LOW,HIGH) for "
        "samples; may be repeated",
    )
    command.add_argument("--samples", type=int, default=32, metavar="N", help="samples; default 32")
    command.add_argument("--seed", type=int, default=0, metavar="S", help="start of random numbers")
    command.add_argument(
        "--workers", type=positive, metavar="N", help="processes; default all cores"
    )
    command.add_argument("--dask", metavar="ADDRESS", help="scheduler of Dask, or local")
    command.add_argument(
        "--model", type=Path, metavar="FILE", help="reduced model that answers (.rom.h5)"
    )
    command.add_argument(
        "--dry-run", action="store_true", help="say what would be solved and what it costs, and end"
    )
    command.add_argument(
        "--slurm",
        type=Path,
        metavar="FILE",
        help="write a script of an array of jobs, as many as --workers says, and end",
    )
    command.add_argument(
        "--part",
        metavar="K/N",
        help="only every N-th point from the K-th, as a job of an array; the same line without it "
        "gathers what parts have found",
    )


def _sensitivity(options: argparse.Namespace) -> None:
    from myork.studies import sensitivity

    out = options.out or _study_folder(options.source)
    with Console(options.verbosity) as console:
        found = sensitivity(
            options.source,
            out,
            vary=options.vary,
            fixed=options.set,
            probe=options.probe,
            samples=options.samples,
            seed=options.seed,
            threads=options.threads,
            progress=console,
        )
    print(f"{found['probe']}: {found['mean']:.4g} +- {found['standard_deviation']:.2g}")
    for key, entry in found["indices"].items():
        alone, total = (
            "{value:.3f} ({low:.3f} to {high:.3f})".format(**entry[kind])
            for kind in ("first_order", "total_order")
        )
        print(f"  {key}: alone {alone}, in all {total}")
    print(_cost(found["cost"]))
    print(f"study: {out / 'sensitivity.csv'}, {out / 'sensitivity.png'}")


def _identify(options: argparse.Namespace) -> None:
    from myork.studies import identify

    out = options.out or _study_folder(options.source)
    with Console(options.verbosity) as console:
        found = identify(
            options.source,
            options.data,
            options.free,
            out,
            fixed=options.set,
            seed=options.seed,
            threads=options.threads,
            progress=console,
        )
    for key, entry in found["parameters"].items():
        low, high = entry["interval"]
        print(f"{key}: {entry['value']:.5g}, 95 % from {low:.5g} to {high:.5g}")
    for line in found["warnings"]:
        print(f"warning: {line}")
    print(_cost(found["cost"]))
    print(f"study: {out / 'identify.json'}, {out / 'identify.csv'}")


def _uncertainty(options: argparse.Namespace) -> None:
    from myork.studies import uncertainty
    from myork.studies.uncertainty import Doubt

    out = options.out or _study_folder(options.source)
    with Console(options.verbosity) as console:
        found = uncertainty(
            options.source,
            out,
            doubt=Doubt(options.bias, options.shift, options.noise, options.length),
            samples=options.samples,
            seed=options.seed,
            probe=options.probe,
            fixed=options.set,
            threads=options.threads,
            progress=console,
        )
    low, high = (found["percentiles"][end] for end in ("2.5", "97.5"))
    print(
        f"{found['probe']}: {found['mean']:.4g} +- {found['standard_deviation']:.2g}, 95 % of the "
        f"maps from {low:.4g} to {high:.4g}; the map as it is: {found['as_it_is']:.4g}"
    )
    print(f"{found['cpu_s']:.1f} s of processor time for {found['maps']} maps")
    print(f"study: {out / 'uncertainty.csv'}, {out / 'uncertainty.png'}")


def _study_folder(source: Path) -> Path:
    return Path("out", source.name.split(".")[0])


def _cost(cost: dict[str, Any]) -> str:
    told = f"{cost['states']} states by {cost['by']}: {cost['cpu_s']:.1f} s of processor time"
    if "full_cpu_s" in cost:
        told += f"; full solves as in the training would take {cost['full_cpu_s']:.0f} s"
    return told


def add_studies(add: Callable[..., argparse.ArgumentParser]) -> None:
    """Commands that ask many states of a model for one answer."""

    def add_study(
        name: str, run: Callable[..., None], what: str, examples: str, source: str
    ) -> argparse.ArgumentParser:
        command = add(
            f"study {name}", run, what, examples, "folder of the results; default out/<name>"
        )
        command.add_argument("source", type=Path, metavar=source.split()[0], help=source)
        command.add_argument(
            "--set",
            type=override,
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="value of another parameter, or override of the deck; may be repeated",
        )
        command.add_argument(
            "--seed", type=int, default=0, metavar="S", help="start of random numbers"
        )
        return command

    either = "MODEL is a reduced model (.rom.h5), or a deck whose scene is solved in full"

    def add_probe(command: argparse.ArgumentParser) -> None:
        command.add_argument(
            "--probe",
            metavar="NAME",
            help="probe, such as reaction or pull_x; default the first force",
        )

    study = add_study(
        "sensitivity",
        _sensitivity,
        "what a force depends on: Sobol's indices over ranges of parameters",
        "  myork study sensitivity block.rom.h5 --samples 256\n"
        "  myork study sensitivity deck.toml --vary material.muscle.A10=5:8 \\\n"
        "      --vary load.activation=0.2:0.4 --samples 32",
        either,
    )
    study.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="KEY=LOW:HIGH",
        help="parameter with its range; default those of the training; may be repeated",
    )
    add_probe(study)
    study.add_argument(
        "--samples", type=int, default=256, metavar="N", help="a power of two; default 256"
    )
    study = add_study(
        "identify",
        _identify,
        "parameters that fit measured forces or displacements, with intervals",
        "  myork study identify block.rom.h5 --data measured.csv --free sigma_max\n"
        "  myork study identify deck.toml --data measured.csv \\\n"
        "      --free material.muscle.sigma_max=20:60 --free material.muscle.A10=4:9",
        either,
    )
    study.add_argument(
        "--data",
        type=Path,
        required=True,
        metavar="FILE",
        help="CSV: a column for each key that was set and each probe, NAME_error for its error",
    )
    study.add_argument(
        "--free",
        action="append",
        required=True,
        metavar="KEY=LOW:HIGH",
        help="parameter that is wanted; KEY alone takes the range of the training",
    )
    study = add_study(
        "uncertainty",
        _uncertainty,
        "what the segmentation's uncertainty does to a force: label maps moved, rebuilt, solved",
        "  myork study uncertainty inputs/mg_muscle.toml --out out/mg_muscle --shift 0.6",
        "DECK of a model from a label map",
    )
    add_probe(study)
    study.add_argument("--samples", type=int, default=12, metavar="N", help="maps; default 12")
    for option, default, told in (
        ("bias", 0.0, "move of all boundaries outwards"),
        ("shift", 0.5, "standard deviation of the move of a whole boundary"),
        ("noise", 0.5, "standard deviation of a move that varies along it"),
        ("length", 10.0, "distance over which that varies"),
    ):
        study.add_argument(
            f"--{option}", type=float, default=default, metavar="MM",
            help=f"{told} [mm]; default {default:g}",
        )  # fmt: skip


def add_view(add_parser: Callable[..., Any], common: argparse.ArgumentParser) -> None:
    """The command that serves a page; it writes no folder."""
    what = "a page with sliders for a reduced model, on this machine, until Ctrl-C"
    view = add_parser(
        "view",
        parents=[common],
        help=what,
        description=what[0].upper() + what[1:] + ".",
        epilog="examples:\n  myork view out/muscle/muscle.rom.h5\n"
        "  myork view muscle.rom.h5 --no-browser --port 8080",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    view.add_argument("file", type=Path, metavar="FILE", help="reduced model (.rom.h5)")
    view.add_argument(
        "--port",
        type=_port,
        default=0,
        metavar="N",
        help="port of this machine; default a free one",
    )
    view.add_argument(
        "--no-browser", action="store_true", help="print the address, open no browser"
    )
    view.set_defaults(run=_view)


def add_rom_commands(
    add: Callable[..., argparse.ArgumentParser], add_deck: Callable[..., argparse.ArgumentParser]
) -> None:
    """Commands of reduced models that outlive their training."""

    def vary(
        command: argparse.ArgumentParser, form: str, example: str, *, required: bool = True
    ) -> None:
        command.add_argument(
            "--vary",
            action="append",
            required=required,
            default=None if required else [],
            metavar=f"KEY={form}",
            help=f"parameter with its range, such as {example}; may be repeated",
        )

    train = add_deck(
        "rom train",
        _rom_train,
        "train a reduced model of a deck that answers for any values of its parameters",
        "  myork rom train inputs/muscle_block.toml --vary load.activation=0:1 \\\n"
        "      --vary boundary.z1.u_z=-0.2:0.3 -o block.rom.h5",
    )
    vary(train, "LOW:HIGH", "load.activation=0:1")
    train.add_argument("-o", "--output", type=Path, metavar="FILE", help="file of the model")
    train.add_argument("--tolerance", type=float, default=1e-3, help="wanted relative error")
    train.add_argument(
        "--full-solves", type=int, default=60, metavar="N", help="full solves at most"
    )
    train.add_argument(
        "--snapshots",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="folders with solutions of the deck, whose states are not solved again",
    )
    train.add_argument(
        "--tests", type=int, default=16, metavar="N", help="further full solves as a test"
    )
    train.add_argument("--seed", type=int, default=0, metavar="S", help="start of random numbers")

    def add_file(
        name: str, run: Callable[[argparse.Namespace], None], what: str, examples: str
    ) -> argparse.ArgumentParser:
        command = add(name, run, what, examples, "folder of the results; default out/<model>")
        command.add_argument("file", type=Path, metavar="FILE", help="reduced model (.rom.h5)")
        return command

    def values(command: argparse.ArgumentParser) -> None:
        command.add_argument(
            "--set",
            type=override,
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="value of a parameter, such as load.activation=0.4; may be repeated",
        )

    solve = add_file(
        "rom solve",
        _rom_solve,
        "the state of a reduced model for values of its parameters",
        "  myork rom solve block.rom.h5 --set load.activation=0.4 --set u_z=0.1 --json",
    )
    values(solve)
    solve.add_argument("--json", action="store_true", help="print JSON")
    grid = add_file(
        "rom map",
        _rom_map,
        "a reduced model over a grid of its parameters: a table and a picture",
        "  myork rom map block.rom.h5 --vary load.activation=0:1:50 --vary u_z=-0.2:0.3:50",
    )
    vary(grid, "LOW:HIGH:N", "load.activation=0:1:21")
    values(grid)
    check = add_file(
        "rom check",
        _rom_check,
        "a reduced model against full solves at parameters that it was not trained on",
        "  myork rom check block.rom.h5 --points 20 --out out/block\n"
        "  myork rom check block.rom.h5 --vary load.activation=0.3:1 --set sigma_max=70",
    )
    vary(
        check, "LOW:HIGH", "load.activation=0.3:1, in place of that of the training", required=False
    )
    values(check)
    check.add_argument("--points", type=positive, default=20, metavar="N", help="full solves")
    check.add_argument("--seed", type=int, default=1, metavar="S", help="start of random numbers")
