"""Write params.yaml, the resolved composition of conf/, for `dvc repro`: python -m pipelines.params [overrides]."""

import sys
from pathlib import Path

from talkingeyes.orchestration.config import compose, write_params
from talkingeyes.orchestration.run import run_command

if __name__ == "__main__":
    run_command(lambda: write_params(Path("params.yaml"), compose(sys.argv[1:])))
