"""`serve`: the records of a stage as an IOC, until a signal ends it."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
from collections.abc import Callable, Mapping

from caproto.asyncio.server import Context
from caproto.server import PVGroup

from stage.errors import ArgumentError, StageError
from stage.ioc.machine_pvs import AxisPVs, StagePVs
from stage.ioc.motion_controller import MotionController, Reading
from stage.ioc.motor_record import MotorRecord
from stage.sim.stage import Stage

PORT_VARIABLES = ("EPICS_CA_SERVER_PORT", "EPICS_CAS_SERVER_PORT")
LOOPBACK_ADDRESS = "127.0.0.1"


class Ioc:
    """IOC of a stage.

    Args:
        stage: Stage that no other code uses.
        prefix: Text before the names of the axes and of the stage's PVs, such as "STAGE:".
        pace: Simulated seconds in a real second, or FREE, see `MotionController`.
        period: Real seconds between two updates of positions.

    Attributes:
        pvs: Names of all PVs.
    """

    def __init__(self, stage: Stage, prefix: str, pace: float = 1.0, period: float = 0.1):
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_publishing = False
        self._controller = MotionController(stage, pace, self._publish_from_worker, period)
        axes = self._controller.axes
        self._axis_pvs = {
            name: AxisPVs(
                prefix + name,
                controller=self._controller,
                axis=axis,
                refuse_request=lambda text, name=name: self._records[name].refuse_request(text),  # type: ignore[misc]
            )
            for name, axis in axes.items()
        }
        self._records: dict[str, MotorRecord] = {
            name: MotorRecord(
                prefix + name, controller=self._controller, axis=axis, publish_machine=self._axis_pvs[name].publish
            )
            for name, axis in axes.items()
        }
        self._stage_pvs = StagePVs(prefix, controller=self._controller)
        groups: list[PVGroup] = [*self._records.values(), *self._axis_pvs.values(), self._stage_pvs]
        self._pvs = {name: pv for group in groups for name, pv in group.pvdb.items()}
        self.pvs = tuple(self._pvs)

    async def run(self, interfaces: list[str], report_start: Callable[[], None]) -> None:
        """Serve until the task is cancelled.

        Args:
            interfaces: Addresses of this machine to listen on.
            report_start: Function that is called once, before the first client can connect.
        """
        self._loop = asyncio.get_running_loop()
        try:
            for name, record in self._records.items():
                await record.start()
                await self._axis_pvs[name].start()
            report_start()
            await Context(self._pvs, interfaces).run(log_pv_names=False)
        finally:
            self._controller.close()

    def _publish_from_worker(self, readings: Mapping[str, Reading]) -> None:
        """Publish readings in the event loop, unless it still publishes earlier ones. The stage's worker calls it."""
        loop = self._loop
        if loop is not None and not self._is_publishing and not loop.is_closed():
            self._is_publishing = True
            loop.call_soon_threadsafe(lambda: loop.create_task(self._publish(readings)))

    async def _publish(self, readings: Mapping[str, Reading]) -> None:
        try:
            for name, reading in readings.items():
                await self._records[name].publish(reading)
                await self._stage_pvs.publish(round(reading.state.time, 3))
        finally:
            self._is_publishing = False


def set_server_port(port: int, interfaces: list[str]) -> None:
    """Choose the port of the IOC by the environment that caproto reads.

    Args:
        port: TCP and UDP port.
        interfaces: Addresses of this machine to listen on.

    Raises:
        ArgumentError: Another program listens on the port. caproto would choose another one without a word.
    """
    for address in interfaces:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((address, port))
            except OSError as error:
                raise ArgumentError(
                    f"port {port} of {address}: {error.strerror}. Choose another --port or --bind."
                ) from error
    for variable in PORT_VARIABLES:
        os.environ[variable] = str(port)


def serve(ioc: Ioc, interfaces: list[str], report_start: Callable[[], None]) -> None:
    """Serve an IOC until Ctrl-C or SIGTERM.

    Args:
        ioc: The IOC.
        interfaces: Addresses of this machine to listen on.
        report_start: Function that is called once, before the first client can connect.

    Raises:
        ArgumentError: The port or an address cannot be used.
    """

    async def run_until_signal() -> None:
        task = asyncio.ensure_future(ioc.run(interfaces, report_start))
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, task.cancel)
        try:
            await task
        except asyncio.CancelledError:
            return

    try:
        asyncio.run(run_until_signal())
    except StageError:
        raise
    except (OSError, RuntimeError) as error:
        raise ArgumentError(
            f"the IOC cannot listen on {', '.join(interfaces)}: {error}. Choose another --port or --bind address."
        ) from error
