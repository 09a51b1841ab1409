"""The control loop and its parts. May import kinematics and what lies below it."""
