"""``python -m protochain`` runs the command line."""

from protochain.cli import main

if __name__ == "__main__":
    main()
