"""``trial/T1-s000.html``: one self-contained page about one trial, for whoever debugs a policy."""
