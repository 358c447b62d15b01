"""The folder for the pictures of a calibration or a verification."""

from pathlib import Path

from service.config.loader import ConfigError


def require_new_folder(folder: Path) -> None:
    """Makes the folder, unless it is there and empty: views of another run would be solved together with this one's.

    Raises:
        ConfigError: it is no empty folder, or cannot be made or read.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        empty = not any(folder.iterdir())
    except FileExistsError:
        empty = False
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ConfigError(f"{folder} cannot be used for the pictures: {why}; name another one by --folder") from error
    if not empty:
        raise ConfigError(f"{folder} is not an empty folder: name a new one by --folder")
