"""VoxPoser (Huang et al., CoRL 2023), implemented from its description: programs written by a language model compose
value maps over the workspace, and a greedy planner follows them. No force map."""
