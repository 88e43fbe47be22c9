"""A vehicle's gimbal, as a script sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from zmav import wire

if TYPE_CHECKING:
    from zmav.vehicle.vehicle import Vehicle


class Gimbal:
    """``vehicle.gimbal``. Angles are rad: pitch up from the horizon, yaw to the right. ``take``: its control also from
    somebody else who has it. Raises what orders raise: :class:`~zmav.errors.Refused` where no gimbal answers.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle

    async def point(
        self,
        *,
        pos: wire.Vector | None = None,
        lat_deg: float | None = None,
        lon_deg: float | None = None,
        alt_amsl: float | None = None,
        alt_rel: float | None = None,
        vehicle: str = "",
        take: bool = False,
    ) -> dict[str, Any]:
        """Have it look at a place (``pos``: m, NED about the fleet's origin) or a vehicle, until the next order."""
        args = wire.PointGimbal(
            pos=pos,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_amsl=alt_amsl,
            alt_rel=alt_rel,
            vehicle=vehicle,
            take=take,
        )
        return await self._vehicle.order("gimbal_point", args)

    async def turn(self, pitch: float, yaw: float = 0.0, *, lock: bool = False, take: bool = False) -> None:
        """Turn it to angles; ``lock``: the yaw is from north and stays, else it is from the nose."""
        await self._vehicle.order("gimbal_turn", wire.TurnGimbal(pitch=pitch, yaw=yaw, lock=lock, take=take))

    async def neutral(self, *, take: bool = False) -> None:
        """Turn it back to where it looks without orders."""
        await self._vehicle.order("gimbal_neutral", wire.TakeGimbal(take=take))

    async def release(self) -> None:
        """Look at nothing more, and give control back."""
        await self._vehicle.order("gimbal_release", wire.Order())

    async def status(self) -> dict[str, Any]:
        """Where it looks, and who controls it."""
        return await self._vehicle.order("gimbal_status", wire.Order())
