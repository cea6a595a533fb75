"""What a policy is told of a trial, for benchmarks that start policies without one."""

from carecontact.interface.robot import ActionBounds, Session

SESSION = Session(
    action_bounds=ActionBounds(
        workspace_low_m=(0.0, -1.0, 0.0), workspace_high_m=(1.0, 1.0, 1.0), translational_stiffness=(100.0, 1000.0),
        rotational_stiffness=(5.0, 50.0),
    ),
    joint_low_rad=(-3.0,) * 7, joint_high_rad=(3.0,) * 7, camera_sizes_px={}, time_limit_s=30.0,
)  # fmt: skip
