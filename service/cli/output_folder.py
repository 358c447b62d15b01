"""The output folder of a calibration or a verification."""

from pathlib import Path

from service.config.loader import ConfigError


def create_output_folder(folder: Path) -> None:
    """Create the folder, or check that it is empty. Views of another run would be solved together with the new ones.

    Raises:
        ConfigError: The path is not an empty folder, or the folder cannot be created or read.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        empty = not any(folder.iterdir())
    except FileExistsError:
        empty = False
    except (OSError, ValueError) as error:  # ValueError: the name has a null character
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ConfigError(f"{folder} cannot be used for the images: {why}; give another folder by --folder") from error
    if not empty:
        raise ConfigError(f"{folder} is not an empty folder: give a new folder by --folder")
