"""The evaluated methods on one protocol, compared with each other and shown beside the paper."""
