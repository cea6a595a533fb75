from tests.policies.conftest import observation, person

__all__ = ["observation", "person"]
