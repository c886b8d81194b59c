"""Where a job runs: options that commands share, and the place that they ask for. Importing this module needs tyro."""

import dataclasses
from contextlib import AbstractContextManager
from typing import Annotated

import tyro

from jaxcap.engine import Place, check_place, chosen, shard_of

WHERE = """  All in this process, unless told otherwise:
    --jobs N        N processes of this machine, which share its cores
    --dask ADDRESS  the workers of a Dask scheduler, tcp://HOST:PORT: on any
                    machines that see the same files, each with --nthreads 1.
                    local: a cluster of N workers on this machine, which ends
                    with the command; --jobs alone does without Dask
    --shard I/N     every Nth part from the Ith, counted from 0: N commands in
                    any queue, in any order, make the whole. With a Slurm
                    array: --shard $SLURM_ARRAY_TASK_ID/64
  The bytes are the same, whatever ran them. What fails, or dies, is tried
  again, 3 times in all. What is done stays done, and the same command goes on
  from there. pydoc jaxcap.engine tells of clusters.
"""
"""For the help of commands."""


@dataclasses.dataclass(frozen=True)
class Where:
    """Where a job runs."""

    jobs: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Processes on this machine."""
    dask: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Scheduler of the Dask cluster that does the work, tcp://HOST:PORT, or local."""
    shard: Annotated[str | None, tyro.conf.arg(metavar="I/N")] = None
    """Which part of the work is done, for example 0/3; by default all."""

    @property
    def given(self) -> str:
        """The first option that is not at its default, for messages."""
        given = ((field.name, getattr(self, field.name), field.default) for field in dataclasses.fields(self))
        return next((f"--{name} {value}" for name, value, default in given if value != default), "")


def check_where(where: Where) -> None:
    """Raises InputError for options that cannot be used."""
    shard_of(where.shard)
    check_place(where.dask, where.jobs)


def place_of(where: Where) -> AbstractContextManager[Place]:
    """The place, for a `with` block, which raises InputError and MissingExtra."""
    return chosen(where.dask, where.jobs)
