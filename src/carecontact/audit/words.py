"""Words of what a policy must not know."""

PRIVILEGED = (
    "force", "torque", "wrench", "stiffness", "tissue", "anchor", "shell", "human_joint", "qpos", "seed", "trial",
    "label", "score", "gate", "comfort", "protocol", "task",
)  # fmt: skip
"""No key of a message may contain one of these words, even if the contract's classes allow it. Keys of a dialect that
contain one are on the dialect's exact list (``hosting.dialects``)."""
