"""The place that options ask for: this process, processes of this machine, or a cluster of Dask."""

from collections.abc import Iterator
from contextlib import contextmanager

from jaxcap.engine.places import Here, Place, processes
from jaxcap.engine.workers import Terms
from jaxcap.errors import InputError, needs_extra


def check_place(dask: str | None, jobs: int) -> None:
    """Raises InputError for options that do not go together. See `chosen`."""
    if jobs < 1:
        raise InputError(f"--jobs {jobs} (expected at least 1)")
    if jobs > 1 and dask not in (None, "local"):
        raise InputError(f"--jobs {jobs} (expected without --dask {dask}, which has its workers)")


@contextmanager
def chosen(dask: str | None, jobs: int, terms: Terms = Terms(), *, apart: bool = False) -> Iterator[Place]:  # noqa: B008
    """A place, in a `with` block.

    Args:
        dask: Address of a scheduler, or "local"; None: processes of this machine.
        jobs: How many, and how many workers of a local cluster.
        terms: What the job asks of its workers.
        apart: A single one is a process of its own, too: it may die, and this one lives.

    Raises:
        InputError: As `check_place`, and for a cluster that cannot be used.
        MissingExtra: For a cluster, without `distributed`.
    """
    check_place(dask, jobs)
    if dask is not None:
        with needs_extra("dask", "--dask"):
            from jaxcap.engine.cluster import cluster
        with cluster(dask, jobs, terms) as place:
            yield place
    elif jobs > 1 or apart:
        with processes(jobs, terms) as place:
            yield place
    else:
        yield Here(terms)
