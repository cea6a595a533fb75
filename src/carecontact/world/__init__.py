"""Builders of the compiled model: person, tissue, furniture, robot, cameras, sensors."""
