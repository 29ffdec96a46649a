"""The compiled core: what Python hands to it and gets from it; only this room imports it."""

from myork.core.threads import MOST_THREADS, thread_count
from myork.errors import InputError

if thread_count() > MOST_THREADS:
    raise InputError(
        f"OMP_NUM_THREADS is {thread_count()}: from 1 to {MOST_THREADS} threads are possible"
    )
