"""``python -m slam_bof`` is ``slam-bof``."""

from slam_bof.cli import main

if __name__ == "__main__":
    main()
