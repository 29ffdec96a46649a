"""Commands of reduced models and sweeps, and what commands share."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from myork.console import Console
from myork.errors import ConvergenceError, InputError

__all__ = [
    "add_rom_commands",
    "add_sweep",
    "add_view",
    "override",
    "overrides_of",
    "positive",
]


def overrides_of(options: argparse.Namespace) -> list[str]:
    """Overrides of the deck, the options with a name of their own last."""
    named = {
        "scene.method": getattr(options, "method", None),
        "solver.linear": getattr(options, "solver", None),
    }
    return options.set + [f"{key}={value}" for key, value in named.items() if value is not None]


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
    if options.json:
        print(json.dumps(state.as_dict()))
    else:
        for name, value in state.as_dict().items():
            print(f"{name}: {value}")
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

    out = options.out or Path("out", options.file.name.split(".")[0])
    out.mkdir(parents=True, exist_ok=True)
    rom = ReducedModel.load(options.file, threads=options.threads or 0)
    with Console(options.verbosity) as console:
        found = compare(rom, rom.full_model(), options.points, options.seed, console)
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
            progress=print if options.dry_run else console,
        )
    if not options.dry_run:
        print(f"table: {table}")


def _view(options: argparse.Namespace) -> None:
    from myork.view import serve

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
    command.add_argument("--dry-run", action="store_true", help="say what would be solved, and end")


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

    def vary(command: argparse.ArgumentParser, form: str, example: str) -> None:
        command.add_argument(
            "--vary",
            action="append",
            required=True,
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
        "  myork rom check block.rom.h5 --points 20 --out out/block",
    )
    check.add_argument("--points", type=positive, default=20, metavar="N", help="full solves")
    check.add_argument("--seed", type=int, default=1, metavar="S", help="start of random numbers")
