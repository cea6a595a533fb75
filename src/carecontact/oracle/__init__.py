"""The privileged baseline: it is given the trial's simulation, so its rate is a ceiling and never ranks as a method."""
