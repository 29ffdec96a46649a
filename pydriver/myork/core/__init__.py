"""The compiled core: conversion of its arguments and results; only this subpackage imports it."""

from myork.errors import InputError, InstallationError, cure_of

try:
    from myork.core.threads import MOST_THREADS, thread_count
except ImportError as reason:
    raise InstallationError(
        f"the compiled core does not load: {reason}; {cure_of(str(reason))}"
    ) from reason

if thread_count() > MOST_THREADS:
    raise InputError(
        f"OMP_NUM_THREADS is {thread_count()}: the number of threads must be between "
        f"1 and {MOST_THREADS}"
    )
