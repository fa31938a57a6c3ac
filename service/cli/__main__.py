"""Run the command line as `python -m service.cli`, for processes that start the service themselves."""

from service.cli import main

if __name__ == "__main__":
    main()
