"""What ``import carecontact`` offers: runs as objects, comparisons, and evaluation of a policy."""
