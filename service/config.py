"""The service's configuration: a TOML file, `POINTCHAIN_*` variables, and what the command line overrides.

The only place that reads the environment or a configuration file. Later ones win: built-in default, TOML
file, variable (`POINTCHAIN_PORT`, nested with two underscores: `POINTCHAIN_LIMITS__UPLOAD_BYTES`), override.
"""

import os
import tomllib
from pathlib import Path
from typing import Any

import platformdirs
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_settings import (
    BaseSettings,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    TomlConfigSettingsSource,
)

from recognition.gripper import Gripper

PREFIX = "POINTCHAIN_"
FILE_VARIABLE = "POINTCHAIN_CONFIG"
"""Variable that names the configuration file when no `--config` does."""


class ConfigError(ValueError):
    """A configuration that cannot be used; the message names each key."""

    slug = "config"


class LimitsConfig(BaseModel):
    """What one request or one scan may use."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    upload_bytes: int = Field(default=512 * 2**20, gt=0)
    """Largest recording that is taken, bytes."""
    request_bytes: int = Field(default=64 * 2**10, gt=0)
    """Largest body of any other request, bytes."""
    recognition_s: float = Field(default=120.0, gt=0, allow_inf_nan=False)
    """Recognition of one scan is stopped after so many seconds."""


class GripperConfig(BaseModel):
    """The gripper that grasps are found for; each key as in `recognition.gripper.Gripper`, metres."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    finger_width_m: float = Gripper.finger_width_m
    finger_thickness_m: float = Gripper.finger_thickness_m
    finger_depth_m: float = Gripper.finger_depth_m
    stroke_m: float = Gripper.stroke_m
    palm_width_m: float = Gripper.palm_width_m
    opening_margin_m: float = Gripper.opening_margin_m
    clearance_m: float = Gripper.clearance_m
    table_clearance_m: float = Gripper.table_clearance_m

    @property
    def value(self) -> Gripper:
        """What recognition takes."""
        return Gripper(**self.model_dump())

    @model_validator(mode="after")
    def _possible(self) -> "GripperConfig":
        # Gripper's own conditions; its error is a ValueError, and names the key.
        _ = self.value
        return self


class ServiceConfig(BaseSettings):
    """All settings of the service."""

    model_config = SettingsConfigDict(
        extra="forbid", frozen=True, env_prefix=PREFIX, env_nested_delimiter="__", env_ignore_empty=True
    )

    data_dir: Path = Field(default_factory=lambda: platformdirs.user_data_path("pointchain", appauthor=False))
    """Folder of recordings, results and the database. Relative to the working directory; the platform's
    folder for application data unless set."""
    host: str = Field(default="127.0.0.1", min_length=1)
    """Address to listen on. Loopback unless set: there is no authentication yet."""
    port: int = Field(default=8000, ge=0, le=65535)
    """TCP port; 0 takes a free one."""
    limits: LimitsConfig = LimitsConfig()
    gripper: GripperConfig = GripperConfig()

    @field_validator("data_dir")
    @classmethod
    def _absolute(cls, value: Path) -> Path:
        return value.expanduser().absolute()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Overrides before variables; `load_config` adds the file behind them."""
        return init_settings, env_settings


def load_config(path: Path | None = None, **overrides: Any) -> ServiceConfig:
    """The configuration from the TOML file `path`, variables and `overrides` (those that are not None).

    Without `path`, the variable POINTCHAIN_CONFIG may name the file.

    Raises:
        ConfigError: the file cannot be read or is not TOML, a key is unknown, or a value cannot be.
    """
    if path is None and os.environ.get(FILE_VARIABLE):
        path = Path(os.environ[FILE_VARIABLE])
    _refuse_unknown_variables()

    class FromFile(ServiceConfig):
        @classmethod
        def settings_customise_sources(
            cls, settings_cls: type[BaseSettings], *args: Any, **kwargs: Any
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            sources = super().settings_customise_sources(settings_cls, *args, **kwargs)
            return sources if path is None else (*sources, TomlConfigSettingsSource(settings_cls, path))

    given = {key: value for key, value in overrides.items() if value is not None}
    try:
        if path is not None and not path.is_file():
            raise ConfigError(f"{path}: there is no such configuration file")
        settings = FromFile(**given)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise ConfigError(_explain(error, path)) from error
    return ServiceConfig.model_construct(**{name: getattr(settings, name) for name in ServiceConfig.model_fields})


def _refuse_unknown_variables() -> None:
    """pydantic-settings reads past a mistyped variable; nobody should have to find that out."""
    known = {f"{PREFIX}{name}".upper() for name in ServiceConfig.model_fields} | {FILE_VARIABLE}
    for variable in sorted(os.environ):
        name = variable.upper()
        if name.startswith(PREFIX) and name.split("__")[0] not in known:
            raise ConfigError(f"{variable}: there is no such setting; known are {', '.join(sorted(known))}")


def _explain(error: ValidationError, path: Path | None) -> str:
    lines = []
    for item in error.errors(include_url=False):
        keys = [str(part) for part in item["loc"]]
        variable = PREFIX + "__".join(keys).upper()
        if item["type"] == "extra_forbidden":
            lines.append(f"{'.'.join(keys)} ({variable}): there is no such setting")
        else:
            lines.append(f"{'.'.join(keys)} ({variable}): {item['msg']}; it is {item['input']!r}")
    where = f" (with {path})" if path else ""
    return f"the configuration{where} cannot be used: " + "; ".join(lines)
