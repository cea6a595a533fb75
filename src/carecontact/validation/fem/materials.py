"""The materials of the layer. Nothing here was fitted to the simulated tissue.

Skin's modulus and thickness are published. The tissue under it (fat and muscle as one) has a modulus that is solved
for, with each skin, so that the layer gives the mean force of published indentations of people at MATCHED_M:
the one number that the finite elements take from the reference curve.
"""

from __future__ import annotations

from dataclasses import dataclass

POISSON = 0.49
"""Assumption: nearly incompressible, as soft tissue is usually taken within seconds of loading."""
OTHER_POISSON = (0.45, 0.495)
"""Further values of Poisson's ratio, which are compared with POISSON for the middle skin."""
FRICTION = 0.5
"""Coefficient of friction between tool and skin: the middle of the reported values for dry skin on smooth materials,
about 0.2 to 0.8 (Derler and Gerhardt 2012, Tribol Lett 45:1), as in the tissue sets."""
OTHER_FRICTION = (0.25, 0.8)
"""Further values of friction, which are compared with FRICTION for the middle skin: cotton on forearm and chest (Temel
et al. 2022, second hand)."""
THICKNESS_M = (0.0008, 0.0015, 0.0022)
"""Least, middle and largest thickness of skin. The mean over people was 0.79 mm (foot) to 1.48 mm (chest) at 24 sites
(Krackowizer and Brenner 2008, Phlebologie 37:83, abstract) and 2.2 mm at arm and abdomen (Gibney et al. 2010, Curr Med
Res Opin 26:1519, abstract). The middle one is our choice."""
MODULUS_PA = (0.13e6, 0.42e6, 0.85e6)
"""Least, middle and largest modulus of skin: 0.129 MPa by suction on the volar forearm (Diridollou et al. 2000, Skin
Res Technol 6:214, abstract); 0.42 MPa in the young and 0.85 MPa in the old by torsion (Agache et al. 1980, Arch
Dermatol Res 269:221; the abstract says that the modulus doubles with age, and its figures come second hand). Published
values from indentation are lower, because they mix skin with what lies under it; the layer without skin represents
them."""
MATCHED_M = 0.004
"""Depth past touch at which layer and reference have the same force: near the end of the forearm's curve, and the
deepest at which the linear layer is used."""


@dataclass(frozen=True, kw_only=True)
class Skin:
    name: str
    thickness_m: float
    """Thickness of the skin; 0 means no skin."""
    modulus_pa: float


PLAIN = Skin(name="plain", thickness_m=0.0, modulus_pa=0.0)
MIDDLE = Skin(name="middle", thickness_m=THICKNESS_M[1], modulus_pa=MODULUS_PA[1])
CORNERS = tuple(
    Skin(name=f"{thin} {soft}", thickness_m=thickness, modulus_pa=modulus)
    for thin, thickness in (("thin", THICKNESS_M[0]), ("thick", THICKNESS_M[2]))
    for soft, modulus in (("soft", MODULUS_PA[0]), ("stiff", MODULUS_PA[2]))
)
SKINS = (MIDDLE, *CORNERS)
"""The skins of the published range: its middle and its corners."""
