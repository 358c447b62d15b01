"""The service's configuration: a TOML file, `POINTCHAIN_*` environment variables and command-line overrides.

Only this module reads the environment or a configuration file. A later source overrides an earlier one: built-in
default, TOML file, variable, override. A variable is named `POINTCHAIN_PORT`, or with two underscores
`POINTCHAIN_ARM__HOST` in a section; its lists are JSON.
"""

import os
import tomllib
from pathlib import Path
from typing import Any

import platformdirs
from pydantic import Field, ValidationError, field_validator
from pydantic.fields import FieldInfo
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    InitSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)

from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import (
    AnyArm,
    AnyCamera,
    CellSettings,
    HandEyeSettings,
    MountingSettings,
    ScanSettings,
    WorkspaceSettings,
)
from cell.config.gripper_config import GripperSettings
from service.config.error_messages import describe_errors, suggest_name
from service.config.sections import LimitsConfig, LogConfig, RetentionConfig, SecurityConfig

PREFIX = "POINTCHAIN_"
PATH_KEYS = {"hand_eye": ("file", "folder"), "camera": ("profile",)}
"""Keys of the cell that are paths, by section."""
FILE_VARIABLE = "POINTCHAIN_CONFIG"
"""Variable that names the configuration file if `--config` is not given."""


class ConfigError(ValueError):
    """The configuration cannot be used. The message names each wrong key."""

    slug = "config"


class ServiceConfig(BaseSettings):
    """All settings of the service and of its cell."""

    model_config = SettingsConfigDict(
        extra="forbid", frozen=True, env_prefix=PREFIX, env_nested_delimiter="__", env_ignore_empty=True
    )

    data_dir: Path = Field(default_factory=lambda: platformdirs.user_data_path("pointchain", appauthor=False))
    """Folder of recordings, results, calibrations and the database. A relative path counts from the working directory.
    The default is the platform's folder for application data."""
    host: str = Field(default="127.0.0.1", min_length=1)
    """Address on which the service listens. An address other than loopback needs at least one token."""
    port: int = Field(default=8000, ge=0, le=65535)
    """TCP port. 0 selects a free port."""
    limits: LimitsConfig = LimitsConfig()
    security: SecurityConfig = SecurityConfig()
    retention: RetentionConfig = RetentionConfig()
    log: LogConfig = LogConfig()
    gripper: GripperSettings = GripperSettings()
    """The parallel gripper for which grasps are computed. Gripper frame: x closing direction, y along the string,
    z approach. With `preset`, `length_m` or `body_m`, it is also a body on the flange, and all moves keep clear with
    it. Without these keys, moves are planned as if the flange were bare."""
    arm: AnyArm = SimulatedArm()
    camera: AnyCamera = SimulatedCamera()
    hand_eye: HandEyeSettings = HandEyeSettings()
    """Hand-eye calibration. Paths in the file count from the folder of the configuration file; paths in variables count
    from the working directory."""
    workspace: WorkspaceSettings = WorkspaceSettings()
    mounting: MountingSettings = MountingSettings()
    scan: ScanSettings = ScanSettings()

    @property
    def cell(self) -> CellSettings:
        """Settings of the cell.

        Raises:
            ValidationError: Its sections contradict one another.
        """
        sections = {name: getattr(self, name) for name in CellSettings.model_fields}
        if self.hand_eye.folder is None:
            sections["hand_eye"] = self.hand_eye.model_copy(update={"folder": self.data_dir / "calibration"})
        return CellSettings(**sections)

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
        """Return the sources, the strongest first: overrides, variables. `load_config` appends the file."""
        return init_settings, _JsonEnvSource(settings_cls)


class _JsonEnvSource(EnvSettingsSource):
    def decode_complex_value(self, field_name: str, field: FieldInfo, value: Any) -> Any:
        """Decode a list or section from JSON. Return other text unchanged: validation rejects it by name."""
        try:
            return super().decode_complex_value(field_name, field, value)
        except ValueError:
            return value


def load_config(path: Path | None = None, **overrides: Any) -> ServiceConfig:
    """Load the configuration from a TOML file, the environment variables and overrides.

    Args:
        path: TOML file. None: the file that the variable POINTCHAIN_CONFIG names, if it is set.
        overrides: Top-level settings that override all other sources. None: not given.

    Raises:
        ConfigError: The file cannot be read or is not TOML, a key is unknown, a value is not accepted, or the cell's
            sections contradict one another. The message lists all wrong keys at once.
    """
    if path is None and os.environ.get(FILE_VARIABLE):
        path = Path(os.environ[FILE_VARIABLE])
    _reject_unknown_variables()
    content = {} if path is None else _read_toml(path)

    class FromFile(ServiceConfig):
        @classmethod
        def settings_customise_sources(
            cls, settings_cls: type[BaseSettings], *args: Any, **kwargs: Any
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            sources = super().settings_customise_sources(settings_cls, *args, **kwargs)
            return *sources, InitSettingsSource(settings_cls, content)

    given = {key: value for key, value in overrides.items() if value is not None}
    try:
        settings = FromFile(**given)
        _ = settings.cell
    except ValidationError as error:
        lines = describe_errors(error, ServiceConfig, _set_variables())
        where = f" (file {path})" if path else ""
        details = lines[0] if len(lines) == 1 else "".join(f"\n  {line}" for line in lines)
        raise ConfigError(f"the configuration{where} cannot be used: {details}") from error
    return ServiceConfig.model_construct(**{name: getattr(settings, name) for name in ServiceConfig.model_fields})


def _read_toml(path: Path) -> dict[str, Any]:
    """Return the content of the file. Relative paths of a cell count from the folder of the file."""
    try:
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such configuration file")
        content = tomllib.loads(path.read_bytes().decode())
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not TOML: it is not UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    for section, keys in PATH_KEYS.items():
        values = content.get(section)
        if not isinstance(values, dict):
            continue
        for key in keys:
            if isinstance(value := values.get(key), str):
                values[key] = str(path.absolute().parent / Path(value).expanduser())
    return content


def _set_variables() -> dict[str, str]:
    """Return our variables that are set (`POINTCHAIN_ARM__HOST`), by the key that they set (`ARM__HOST`)."""
    ours = [name for name, value in os.environ.items() if name.upper().startswith(PREFIX) and value]
    return {name.upper().removeprefix(PREFIX): name for name in sorted(ours)}


def _reject_unknown_variables() -> None:
    """Raise ConfigError for a mistyped variable, which pydantic-settings would ignore."""
    known = sorted([name.upper() for name in ServiceConfig.model_fields] + [FILE_VARIABLE.removeprefix(PREFIX)])
    for key, variable in _set_variables().items():
        if key.split("__")[0] not in known:
            raise ConfigError(f"{variable}: unknown setting; {suggest_name(key.split('__')[0], known, PREFIX)}")
