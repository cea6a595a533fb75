"""carecontact: does a robot policy touch people well?"""

__version__ = "0.1.0"
