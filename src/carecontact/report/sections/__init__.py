"""One file a section of the page: its data and its part of the template."""
