"""``python -m slam_bof`` is ``slam-bof``."""

from slam_bof.cli import main

__all__: list[str] = []

if __name__ == "__main__":
    main()
