"""The moment of a trial with the largest force: where the robot pressed, how hard, how deep, and its picture."""
