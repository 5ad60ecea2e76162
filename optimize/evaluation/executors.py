"""Choice of an executor: local processes, or a Dask cluster."""

from __future__ import annotations

from optimize.evaluation.evaluation import Job
from optimize.evaluation.interface import Executor
from optimize.evaluation.local_executor import LocalExecutor


def make_executor(job: Job, workers: int = 1, scheduler: str | None = None) -> Executor:
    """Workers for a job: local processes, or those of the Dask scheduler at an address such as tcp://host:8786.

    Raises:
        SearchError: no worker can be had.
        MoflockError: the job cannot be flown.
    """
    if scheduler is None:
        return LocalExecutor(job, workers)
    from optimize.evaluation.dask_executor import DaskExecutor  # noqa: PLC0415 - an extra, which need not be installed

    return DaskExecutor(job, scheduler)
