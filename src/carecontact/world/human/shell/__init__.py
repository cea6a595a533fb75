"""The meshed surface of a soft region, sampled from the body: around a limb, or over the abdomen."""

from carecontact.world.human.shell.keep import kept_shell
from carecontact.world.human.shell.limb import limb_shell
from carecontact.world.human.shell.shell import Shell
from carecontact.world.human.shell.trunk import belly_half_width, belly_span, trunk_shell

__all__ = ["Shell", "belly_half_width", "belly_span", "kept_shell", "limb_shell", "trunk_shell"]
