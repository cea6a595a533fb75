"""The person in the laboratory: validation, finite elements, and calibration against measured presses."""
