"""The abdomen, from the pelvis to the lower ribs."""

from carecontact.regions.region import REGIONS, Belly, Region, TrunkSight

REGIONS.register(
    "abdomen",
    Region(
        segment="abdomen",
        neighbourhood=("thorax", "abdomen", "pelvis"),
        shape=Belly(held_out_m=((0.018, -0.020), (-0.020, 0.026), (0.012, 0.040), (-0.014, -0.045), (0.004, 0.012))),
        words=("abdomen", "belly", "stomach", "tummy"),
        # Middle: the umbilicus is at 0.61 of stature, hip and shoulder joints at 0.53 and 0.82 (Drillis and Contini
        # 1966). Length: the soft belly, symphysis to lower ribs; assumed.
        sight=TrunkSight(joints=("hip", "shoulder"), ahead=(-0.035, -0.025), middle=0.27, length=0.40),
    ),
)
