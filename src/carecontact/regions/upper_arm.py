"""The right upper arm, from under the armpit to the elbow."""

from carecontact.regions.region import REGIONS, LimbSight, Region, Tube

REGIONS.register(
    "upper_arm",
    Region(
        segment="right_upper_arm",
        neighbourhood=("right_forearm", "right_upper_arm", "thorax"),
        shape=Tube(
            # It begins under the armpit, where the arm is a tube.
            span=(0.25, 0.97),
            closed_by=("clavicle", "forearm"),
            # The shoulder's cap reaches over the joint.
            near_end_from=-0.25,
            beside_trunk=True,
            held_out_m=((0.016, -0.007), (-0.019, 0.009), (0.006, 0.011)),
        ),
        words=("upper arm", "upper-arm", "upperarm", "biceps", "bicep", "triceps"),
        # Free of the trunk from the fold of the armpit on; that share is assumed.
        sight=LimbSight(joints=("shoulder", "elbow"), ahead=(0.11, 0.06), free_from=0.33),
        close_up_azimuth_deg=15.0,
        # Toward the elbow, where the robot's hand stays clear of a large chest.
        scripted_along_m=0.055,
    ),
)
