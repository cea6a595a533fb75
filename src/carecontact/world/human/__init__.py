"""The supine care recipient: skeleton, passive joints, soft regions, skin."""
