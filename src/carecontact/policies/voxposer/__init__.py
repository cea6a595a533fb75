"""VoxPoser (Huang et al., CoRL 2023): a language model's programs write value maps, a greedy planner follows them."""
