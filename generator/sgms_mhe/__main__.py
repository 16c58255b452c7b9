"""`python -m sgms_mhe`: the command line."""

from sgms_mhe.cli import main

if __name__ == "__main__":
    main()
