"""From camera images to what a policy may see."""
