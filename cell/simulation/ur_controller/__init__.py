"""A virtual UR controller, in a process of its own on a loopback address: RTDE, script port and dashboard.

    python -m cell.simulation.ur_controller --host 127.0.0.2

`launcher.start_controller` starts one from Python. `admin_client.AdminClient` reads its state and its log, and injects
faults. Its clients are the real ones: the unmodified ur_rtde drives it.

What it reproduces:

- UR3e, UR5e and UR10e kinematics with the nominal Denavit-Hartenberg tables, and inverse kinematics with all branches,
  of which the one nearest to the present joint angles is taken. With `--pose-error-m` the reported flange pose differs
  from the actual one by a smooth error that depends on the joint angles.
- Joint moves with trapezoidal speed and synchronised joints, linear moves, stops with the requested deceleration, and
  the speed slider. Motion follows the clock: a late cycle shows a later moment of the same trajectory.
- RTDE in protocol versions 2 and 1 at 1 to 500 Hz: recipes with NOT_FOUND and IN_USE, one owner of each input
  register, pause, text messages, and the watchdog, which excuses moments in which a busy machine did not run this
  process. A client that does not read is disconnected. Variables that UR added in a later software version than the
  reported one are NOT_FOUND.
- The time of the controller is a count of control cycles of 2 ms. RTDE's `timestamp` advances in exact steps of it.
  After a delay of up to 20 ms, the missed cycles and their packages are made up for. After a longer delay, they are
  omitted, as a real controller omits packages, and the count is in step with the clock again.
- The program that ur_rtde uploads: which command is read when, which one blocks, what an asynchronous move reports,
  which kind of stop is made, and that a synchronous move cannot be stopped.
- Program, power and safety states and their dependencies: a protective stop pauses the program, `play` resumes the
  interrupted move, and unlocking takes five seconds. An emergency stop turns the power off. Local control rejects
  commands. An uploaded program replaces the running one. A program that ends, or whose watchdog expires, brakes the
  arm.
- The dashboard requests of PolyScope 5, with the exact answers. A `stop` is answered when the arm is at rest, `brake
  release` powers on first, and `shutdown` switches the arm off and refuses connections until the admin call `clear`.
- Joint limits and, if configured, a plane below which the flange must not move.

What it does not reproduce:

- Programs are recognised by their header, not interpreted. Of ur_rtde's own program, the commands for jogging, speed,
  servo, force, freedrive, contact detection and circular moves are acknowledged without effect
  (`command_without_effect` in the log). Other programs run without effect until they are stopped. Single lines and
  secondary programs are ignored.
- Dynamics: actual values equal target values; currents, torques and forces are zero. A path stops at each of its
  points, without blends. Self-collisions are not detected.
- Decelerations at a protective stop, at the end of a program and between two moves are constants, not those of a
  safety configuration. Powering on and releasing the brakes take 0.3 s each.
- The state streams of ports 30001 to 30003 and PolyScope X are missing.
- Dashboard: there are no program files, and `default.installation` is the only installation. The operational mode is
  kept and reported, but restricts nothing. Popups, log messages, flight reports and support files are answered and not
  made.

The behaviour of a real controller is not known in five points, which are choices here: output registers keep their
values between programs, the bit "program is running" stays set while the program is paused, and the watchdog does not
run while it is paused. RTDE refuses rates below 1 Hz. A period that is no whole number of cycles is rounded up: 300 Hz
becomes 250 Hz.

Events of the log: connected, disconnected, rtde_start, rtde_refused, rtde_overflow, rtde_text, speed_slider;
script_upload, script_refused, script_ignored, script_error; command (commands of ur_rtde to its program, except for
watchdog signals), command_without_effect; motion_start, motion_done, braking (with its reason), still; program_state,
program_killed, program_stopped (with its reason); watchdog_armed, watchdog_expired; safety, robot_mode; dashboard
(request and answer); fault (request to the admin port). Stamps are those of `time.monotonic()`, which all processes of
a Linux machine share.
"""
