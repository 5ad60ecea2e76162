"""Factory of executors: local processes or a Dask cluster."""

from __future__ import annotations

from optimize.evaluation.evaluation import Job
from optimize.evaluation.interface import Executor
from optimize.evaluation.local_executor import LocalExecutor


def make_executor(job: Job, workers: int = 1, scheduler: str | None = None) -> Executor:
    """Open an executor for a job: local processes, or the workers of the Dask scheduler at an address.

    Args:
        job: common settings of all evaluations.
        workers: number of local processes.
        scheduler: address such as tcp://host:8786; None for local processes.

    Raises:
        SearchError: no worker can be started or reached.
        MoflockError: the job cannot be flown.
    """
    if scheduler is None:
        return LocalExecutor(job, workers)
    from optimize.evaluation.dask_executor import DaskExecutor  # noqa: PLC0415 - an optional dependency

    return DaskExecutor(job, scheduler)
