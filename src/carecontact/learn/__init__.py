"""Gymnasium environments in which policies learn, on persons of whom none is in the exam."""

from carecontact.errors import DependencyError

try:
    import gymnasium
except ImportError:
    raise DependencyError("carecontact.learn needs gymnasium: pip install 'carecontact[learn]'") from None

from carecontact.learn.bathing import LEVELS, TASKS, Bathing, BathingState, make_vec
from carecontact.learn.persons import TRAINING_SALT, TRAINING_SHA256

__all__ = ["LEVELS", "TASKS", "TRAINING_SALT", "TRAINING_SHA256", "Bathing", "BathingState", "make_vec"]

for _suffix, _kind in (("", "Bathing"), ("-State", "BathingState")):
    _entry = f"carecontact.learn.bathing:{_kind}"
    gymnasium.register(id=f"carecontact/Bathing{_suffix}-v0", entry_point=_entry)
    for _task in TASKS:
        for _level in LEVELS:
            gymnasium.register(
                id=f"carecontact/Bathing-{_task}-{_level}{_suffix}-v0",
                entry_point=_entry,
                kwargs={"tasks": _task, "level": _level},
            )
