"""The testbed's errors: each is one line that names the field, its value and the limit."""


class MoflockError(Exception):
    """What a user can cause and mend; every other exception is a fault of the program."""


class StoppedError(Exception):
    """The user stopped a command before its end; the message says how to go on."""


class AirframeError(MoflockError):
    """An airframe is unknown, or its model file does not describe a multirotor that can be flown."""


class ScenarioError(MoflockError):
    """A scenario has a field, a value or a combination that cannot be flown."""


class PointError(MoflockError):
    """A parameter point is unknown, unreadable or out of bounds."""


class LogError(MoflockError):
    """A log cannot be written, read or recovered."""


class FlightError(MoflockError):
    """A flight cannot go on, such as one whose state is no longer finite."""


class RenderError(MoflockError):
    """A flight cannot be drawn, or its picture or video cannot be written."""


class SearchError(MoflockError):
    """A search cannot be set up, run or resumed: its bounds, its objectives, its run directory or its workers."""


class LinkError(MoflockError):
    """A link to a vehicle cannot be opened: its address, its port or its signing key."""


class FleetError(MoflockError):
    """A fleet of simulated vehicles cannot be set up: its size, its faults or its speed."""


class CommandError(MoflockError):
    """A vehicle does not do what it was asked for, or does not answer."""


class DeploymentError(MoflockError):
    """A deployment cannot begin: its vehicles, its report, its point or its place."""


class ReportError(MoflockError):
    """A report of a pre-flight check cannot be read, was edited, or does not allow the deployment."""


class CheckFailedError(MoflockError):
    """What was to be done was checked before, and failed."""
