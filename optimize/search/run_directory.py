"""Directory of one search, with its configuration and its archive of evaluations."""

from __future__ import annotations

from pathlib import Path

from optimize.evaluation.archive import Archive, read_directory, write_directory
from optimize.search.configuration import Configuration


class RunDirectory(Archive):
    """Directory of a search, made by `create` or opened by `open`.

    Attributes:
        configuration: configuration of the search.
        screening: archive of the screening flights on point masses, `screening.sqlite`; or None.
    """

    def __init__(self, path: Path, configuration: Configuration) -> None:
        super().__init__(path, configuration.bounds.spec)
        self.configuration = configuration
        self.screening = (
            Archive(path, configuration.bounds.spec, "screening.sqlite") if configuration.settings.screen else None
        )

    def repair(self) -> None:
        """See `Archive`; repairs both archives."""
        super().repair()
        if self.screening:
            self.screening.repair()

    def count_damaged(self) -> int:
        """See `Archive`; returns the sum over both archives, while `damaged` stays that of each one."""
        damaged = super().count_damaged()
        return damaged + (self.screening.count_damaged() if self.screening else 0)

    def close(self) -> None:
        """See `Archive`; closes both archives."""
        super().close()
        if self.screening:
            self.screening.close()

    @classmethod
    def create(cls, path: str | Path, configuration: Configuration) -> RunDirectory:
        """Create a run directory.

        Raises:
            SearchError: the directory is not empty or cannot be written.
        """
        write_directory(Path(path), configuration.scenario, configuration.to_json())
        return cls(Path(path), configuration)

    @classmethod
    def open(cls, path: str | Path) -> RunDirectory:
        """Open a run directory; damaged rows of its archives are skipped.

        Raises:
            SearchError: the path is not a run directory, or its configuration or archive cannot be read.
        """
        run = cls(Path(path), read_directory(Path(path), Configuration.from_texts))
        run.count_damaged()
        return run
