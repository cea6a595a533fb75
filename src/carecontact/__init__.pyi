from carecontact.programs.compare import compare as compare
from carecontact.programs.evaluate import evaluate as evaluate
from carecontact.programs.run import Run as Run
from carecontact.programs.run import load as load

__version__: str
