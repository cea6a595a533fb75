"""The right hand, as a rigid region."""

from carecontact.interface.regions import Region

RIGHT_HAND = Region(segment="right_hand", neighbourhood=("right_hand", "right_forearm"), words=("palm",))
