"""Run the command line as `python -m panoloc.service.cli`, for processes that start the service themselves."""

from panoloc.service.cli import main

if __name__ == "__main__":
    main()
