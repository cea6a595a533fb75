"""The right forearm, from the elbow to the wrist."""

from carecontact.regions.region import REGIONS, LimbSight, Region, Tube

REGIONS.register(
    "forearm",
    Region(
        segment="right_forearm",
        neighbourhood=("right_hand", "right_forearm", "right_upper_arm"),
        shape=Tube(
            span=(0.05, 0.96),
            # The forearm is also pushed from the side: 90 degrees must lie between free vertices.
            pushed_from_side=True,
            closed_by=("upper_arm", "hand"),
            held_out_m=((0.016, -0.007), (-0.019, 0.009), (0.045, -0.009), (-0.052, 0.004), (0.006, 0.011)),
        ),
        words=("forearm", "fore arm", "fore-arm", "lower arm"),
        sight=LimbSight(joints=("elbow", "wrist")),
    ),
)
