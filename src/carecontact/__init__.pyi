from carecontact.api.evaluate import evaluate as evaluate
from carecontact.api.run import Run as Run
from carecontact.api.run import compare as compare
from carecontact.api.run import load as load

__version__: str
