"""The mission protocol of one vehicle, which stores a fence and reports an empty mission and no rally points.

https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.fence import FenceError

ITEMS_MAX = 200
"""Maximum number of items of a fence."""
_FENCE = mavlink.MAV_MISSION_TYPE_FENCE
_RETRY = 1.0
"""Interval at which the request of an item is repeated, s."""
_RETRIES = 5

Reply = Callable[[Message, object], None]
"""Function that sends a message to a peer."""


@dataclasses.dataclass(kw_only=True)
class _Upload:
    """A fence upload in progress."""

    peer: object
    system: int
    component: int
    count: int
    requested: float
    retries: int = 0
    items: list[Message] = dataclasses.field(default_factory=list)


class FenceStore:
    """A vehicle's fence as mission items that can be uploaded, listed and cleared.

    Args:
        reply: function that sends a message.
        accept: callback that receives the items of a new fence, and raises FenceError to keep the old one.
    """

    def __init__(self, reply: Reply, accept: Callable[[Sequence[Message]], None]) -> None:
        self.items: list[Message] = []
        self._reply = reply
        self._accept = accept
        self._upload: _Upload | None = None

    def receive(self, message: Message, peer: object, time: float) -> None:
        """Answer a message of the protocol."""
        kind, sender = message.get_type(), (message.get_srcSystem(), message.get_srcComponent())
        if kind == "MISSION_REQUEST_LIST":
            count = len(self.items) if message.mission_type == _FENCE else 0
            self._reply(mavlink.MAVLink_mission_count_message(*sender, count, message.mission_type), peer)
        elif kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            self._send_item(message, peer)
        elif kind == "MISSION_COUNT":
            self._begin(message, peer, time)
        elif kind == "MISSION_ITEM_INT":
            self._take_item(message, peer, time)
        elif kind == "MISSION_CLEAR_ALL":
            if message.mission_type in (_FENCE, mavlink.MAV_MISSION_TYPE_ALL):
                self._store([])
            self._acknowledge(*sender, message.mission_type, mavlink.MAV_MISSION_ACCEPTED, peer)
        elif kind == "MISSION_ACK" and self._upload and self._upload.peer is peer and message.mission_type == _FENCE:
            self._upload = None  # the sender cancelled the upload

    def update(self, time: float) -> None:
        """Repeat the request of a missing item, and cancel the upload after `_RETRIES`."""
        upload = self._upload
        if upload is None or time - upload.requested < _RETRY:
            return
        if upload.retries == _RETRIES:
            self._upload = None
            cancelled = mavlink.MAV_MISSION_OPERATION_CANCELLED
            self._acknowledge(upload.system, upload.component, _FENCE, cancelled, upload.peer)
            return
        upload.retries += 1
        self._request(upload, time)

    def _begin(self, message: Message, peer: object, time: float) -> None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if message.count == 0:
            if message.mission_type == _FENCE:
                self._store([])
            self._acknowledge(*sender, message.mission_type, mavlink.MAV_MISSION_ACCEPTED, peer)
        elif message.mission_type != _FENCE:
            self._acknowledge(*sender, message.mission_type, mavlink.MAV_MISSION_UNSUPPORTED, peer)
        elif message.count > ITEMS_MAX:
            self._acknowledge(*sender, _FENCE, mavlink.MAV_MISSION_NO_SPACE, peer)
        else:
            self._upload = _Upload(
                peer=peer, system=sender[0], component=sender[1], count=message.count, requested=time
            )
            self._request(self._upload, time)

    def _take_item(self, message: Message, peer: object, time: float) -> None:
        upload = self._upload
        if upload is None or upload.peer is not peer or message.mission_type != _FENCE:
            return
        if message.seq != len(upload.items):
            self._request(upload, time)
            return
        upload.items.append(message)
        upload.retries = 0
        if len(upload.items) < upload.count:
            self._request(upload, time)
            return
        self._upload = None
        try:
            self._store(upload.items)
            result = mavlink.MAV_MISSION_ACCEPTED
        except FenceError:
            result = mavlink.MAV_MISSION_INVALID
        self._acknowledge(upload.system, upload.component, _FENCE, result, peer)

    def _store(self, items: list[Message]) -> None:
        self._accept(items)
        self.items = items

    def _request(self, upload: _Upload, time: float) -> None:
        upload.requested = time
        request = mavlink.MAVLink_mission_request_int_message(
            upload.system, upload.component, len(upload.items), _FENCE
        )
        self._reply(request, upload.peer)

    def _send_item(self, message: Message, peer: object) -> None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if message.mission_type != _FENCE or not 0 <= message.seq < len(self.items):
            self._acknowledge(*sender, message.mission_type, mavlink.MAV_MISSION_INVALID_SEQUENCE, peer)
            return
        item = self.items[message.seq]
        answer = mavlink.MAVLink_mission_item_int_message(
            *sender, message.seq, item.frame, item.command, 0, 1,
            item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z, _FENCE,
        )  # fmt: skip
        self._reply(answer, peer)

    def _acknowledge(self, system: int, component: int, mission_type: int, result: int, peer: object) -> None:
        self._reply(mavlink.MAVLink_mission_ack_message(system, component, result, mission_type), peer)
