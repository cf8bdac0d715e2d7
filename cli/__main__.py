"""The command as `python -m softdeca.cli`."""

from . import main

if __name__ == "__main__":
    main()
