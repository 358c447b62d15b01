"""A virtual UR controller, in a process of its own on a loopback address: RTDE, script port and dashboard.

    python -m cell.simulation.ur_controller --host 127.0.0.2

`process.start_controller` starts one from Python, `admin.AdminClient` asks it where the flange is, reads its log and
makes faults. Its clients are real: the unmodified ur_rtde drives it, others read it.

What it is faithful in:

- UR3e, UR5e and UR10e kinematics with the nominal Denavit-Hartenberg tables; inverse kinematics with all branches,
  the one nearest to the present joints is taken.
- Joint moves with trapezoidal speed and joints in step, linear moves, stops with the deceleration asked for, the speed
  slider. Motion follows the clock: a late cycle shows a later moment of the same trajectory.
- RTDE in protocol versions 2 and 1 at up to 500 Hz: recipes with NOT_FOUND and IN_USE, one owner of each input
  register, pause, texts, the watchdog (for which moments do not count in which a busy machine kept this process from
  running); a client that does not read is disconnected.
- The program that ur_rtde uploads: which command is read when, what blocks, what an asynchronous move reports, which
  kind of stop is made, and that a synchronous move can't be stopped.
- Program, power and safety states as they hang together: a protective stop pauses the program, `play` goes on with the
  old move, unlocking takes five seconds; an emergency stop takes the power; local control refuses; an uploaded program
  kills the one that runs; a program that ends or starves its watchdog brakes the arm.
- Dashboard requests and answers, word for word, for what a scanning cell asks; a `stop` is answered at rest.
- Joint limits and, if asked for, a plane that the flange must not come below.

What it is not:

- Programs are recognised by their header, not interpreted; of ur_rtde's own, jogging, speed, servo, force and freedrive
  commands, contact detection and circular moves are answered as done and do nothing (`command_without_effect` in the
  log). Other programs run and do nothing until they are stopped. Single lines and secondary programs are ignored.
- No dynamics: actual values equal target values; currents, torques and forces are zero; no blends (a path stops at each
  of its points), no controller calibration (the flange pose is the nominal one), no self collision.
- Decelerations at a protective stop, at the end of a program and between two moves are one figure each, not the
  safety configuration's; powering on and releasing brakes take 0.3 s each.
- The state streams of ports 30001 to 30003 and PolyScope X are missing. Loading programs, the installation and the
  operational modes of the dashboard are answered at most.

Not known of the real thing, and so a choice: output registers keep their values between programs, the bit "program is
running" stays set while the program is paused, and the watchdog does not run while it is paused.

The log's events: connected, disconnected, rtde_start, rtde_refused, rtde_overflow, rtde_text, speed_slider;
script_upload, script_refused, script_ignored, script_error; command (what ur_rtde asks of its program, but for the
watchdog's food), command_without_effect; motion_start, motion_done, braking (with its reason), still;
program_state, program_killed, program_stopped (with its reason); watchdog_armed, watchdog_expired; safety, robot_mode;
dashboard (request and answer); fault (what the admin port was asked to do). Stamps are those of `time.monotonic()`,
which all processes of a Linux machine share.
"""
