"""What `import carecontact` offers to Python programs: runs as objects, comparisons, and evaluation of a policy."""
