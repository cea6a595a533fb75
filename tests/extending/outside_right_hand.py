"""The right hand: rigid, so it needs no tissue."""

from carecontact.regions import Region

RIGHT_HAND = Region(
    segment="right_hand",
    neighbourhood=("right_hand", "right_forearm"),
    words=("palm",),
    close_up_azimuth_deg=75.0,
)
