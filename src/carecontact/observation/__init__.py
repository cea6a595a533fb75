"""Makes what a policy may see from camera images and encoders."""
