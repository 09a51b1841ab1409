"""Robot YAML files from vendors' URDFs. May import kinematics and control."""
