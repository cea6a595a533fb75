"""One file a metric; a recording alone decides its value."""
