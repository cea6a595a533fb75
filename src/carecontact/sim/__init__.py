"""A compiled scene in motion: stepping, sensors, impedance targets, rendering."""
