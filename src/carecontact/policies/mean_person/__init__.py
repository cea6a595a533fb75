"""The blind baseline that acts on the mean person: it is told where the camera stands, and sees nothing."""
