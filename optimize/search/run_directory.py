"""The directory of one search: its configuration and its archive of evaluations."""

from __future__ import annotations

from pathlib import Path

from optimize.evaluation.archive import Archive, read_directory, write_directory
from optimize.search.configuration import Configuration


class RunDirectory(Archive):
    """A search's directory, made by `create` or found by `open`.

    Attributes:
        configuration: what is searched, and how.
        screening: the archive, `screening.sqlite`, of the flights on point masses by which bodies are chosen; or None.
    """

    def __init__(self, path: Path, configuration: Configuration) -> None:
        super().__init__(path, configuration.bounds.spec)
        self.configuration = configuration
        self.screening = (
            Archive(path, configuration.bounds.spec, "screening.sqlite") if configuration.settings.screen else None
        )

    def repair(self) -> None:
        """See `Archive`; both."""
        super().repair()
        if self.screening:
            self.screening.repair()

    def count_damaged(self) -> int:
        """See `Archive`; the rows of both, while each remembers its own."""
        damaged = super().count_damaged()
        return damaged + (self.screening.count_damaged() if self.screening else 0)

    def close(self) -> None:
        """See `Archive`; both."""
        super().close()
        if self.screening:
            self.screening.close()

    @classmethod
    def create(cls, path: str | Path, configuration: Configuration) -> RunDirectory:
        """Make a new run directory.

        Raises:
            SearchError: there is something already, or it cannot be written.
        """
        write_directory(Path(path), configuration.scenario, configuration.to_json())
        return cls(Path(path), configuration)

    @classmethod
    def open(cls, path: str | Path) -> RunDirectory:
        """Open a run directory; what is damaged in its archive is left out.

        Raises:
            SearchError: it is none, or its configuration or its archive cannot be read at all.
        """
        run = cls(Path(path), read_directory(Path(path), Configuration.from_texts))
        run.count_damaged()
        return run
