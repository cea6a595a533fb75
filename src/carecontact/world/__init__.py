"""Builders of the compiled model around the person: robot, furniture, cameras, sensors, and what each seed draws."""
