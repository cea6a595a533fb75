"""The person as a body: anatomy, joints, pose, shells and hulls, skeleton and skin."""
