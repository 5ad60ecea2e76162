"""The geographic origin of the arena: given by the user, or the mean of the vehicles' homes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from moflock_mj.errors import DeploymentError
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.frames import Origin


def parse_origin(text: str) -> tuple[float, float]:
    """Parse latitude and longitude, degrees, from a text such as 47.397742,8.545594.

    Raises:
        DeploymentError: the text has another form, or a value is out of bounds.
    """
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        raise DeploymentError(f"origin: {text!r}: it must be LATITUDE,LONGITUDE in degrees") from None
    if not (abs(latitude) <= 85 and abs(longitude) <= 180):
        raise DeploymentError(f"origin: {text!r} is out of bounds: it must be within 85 and 180 degrees")
    return latitude, longitude


def find_origin(vehicles: Sequence[RemoteVehicle], place: tuple[float, float] | None) -> Origin:
    """Centre of the arena: the given place, else the mean of the vehicles' homes.

    Its altitude is the mean altitude of the homes, so that the flock's height is above its take-off place.
    """
    homes = [home for vehicle in vehicles if (home := vehicle.home()) is not None]
    count, first = len(homes), homes[0][1]
    # Longitudes are averaged relative to the first one, so that the date line has no effect.
    turns = [math.remainder(longitude - first, 360.0) for _, longitude, _ in homes]
    latitude, longitude = place or (
        sum(home[0] for home in homes) / count,
        math.remainder(first + sum(turns) / count, 360.0),
    )
    return Origin(latitude=latitude, longitude=longitude, altitude=sum(home[2] for home in homes) / count)
