"""How checked actions become commands of the robot's controller: one file for each family of action spaces."""

from carecontact.episode.drivers.driver import Driver, driver_of

__all__ = ["Driver", "driver_of"]
