"""`python -m collaborative_gym --env ID` is `collaborative-gym view ID`."""

import sys

from collaborative_gym.cli.main import main

if __name__ == "__main__":
    arguments = sys.argv[1:]
    if arguments and arguments[0].startswith("--env"):
        arguments = ["view", *arguments[0].split("=")[1:], *arguments[1:]]
    sys.exit(main(arguments))
