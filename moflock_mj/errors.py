"""Errors for the user. Each message is one line that names the field, its value and the limit."""


class MoflockError(Exception):
    """An error that the user can correct. Any other exception is a bug."""


class StoppedError(Exception):
    """A command stopped at the user's request; the message says how to continue."""


class AirframeError(MoflockError):
    """Unknown airframe, or a model file that does not describe a supported multirotor."""


class ScenarioError(MoflockError):
    """Invalid field, value or combination in a scenario."""


class PointError(MoflockError):
    """Unknown, unreadable or out-of-bounds parameter point."""


class LogError(MoflockError):
    """Failure to write, read or recover a log."""


class FlightError(MoflockError):
    """Failure of a running flight, such as a state that is no longer finite."""


class RenderError(MoflockError):
    """Failure to render a flight, or to write its picture or video."""


class SearchError(MoflockError):
    """Failure to set up, run or resume a search: bounds, objectives, run directory or workers."""


class LinkError(MoflockError):
    """Failure to open a link to a vehicle: address, port or signing key."""


class FleetError(MoflockError):
    """Failure to set up a fleet of simulated vehicles: size, faults or speed."""


class CommandError(MoflockError):
    """Command that a vehicle rejects, does not carry out or does not acknowledge."""


class DeploymentError(MoflockError):
    """Failure to start a deployment: vehicles, report, point or location."""


class ReportError(MoflockError):
    """Pre-flight report that is unreadable or edited, or that does not permit the deployment."""


class CheckFailedError(MoflockError):
    """Failed check before an operation."""
