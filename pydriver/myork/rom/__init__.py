"""Reduced order models: snapshots -> modes -> reduced solves -> errors and timings."""

from myork.rom.study import run_rom

__all__ = ["run_rom"]
