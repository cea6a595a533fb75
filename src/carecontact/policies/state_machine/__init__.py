"""The state machine, the paper's first method: one look, one choice by language, one open-loop plan."""
