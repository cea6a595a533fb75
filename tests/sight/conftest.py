from tests.policies.state_machine.conftest import observation, person

__all__ = ["observation", "person"]
