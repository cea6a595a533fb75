"""Words of what a policy must not know."""

PRIVILEGED = (
    "force", "torque", "wrench", "stiffness", "tissue", "anchor", "shell", "human_joint", "qpos", "seed", "trial",
    "label", "score", "gate", "comfort", "protocol", "task",
)  # fmt: skip
"""No key of a message may contain one of these words, whatever the contract's classes say. A dialect's own keys that do
are on its exact list (``hosting.dialects``)."""
