"""Starts the program mr-slam as a robot, as the base or as a whole fleet, and RViz on request.

ros2 launch mr_slam mr_slam.launch.py mode:=up names:=alice,bob
ros2 launch mr_slam mr_slam.launch.py mode:=robot name:=alice base:=quic/192.168.1.10:7447
ros2 launch mr_slam mr_slam.launch.py mode:=base names:=alice,bob rviz:=true
"""

import os
import shlex

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# What mr-slam may take to stop its processes and to write the maps, seconds.
STOP_S = '20'

# Name, default and description of each launch argument.
ARGUMENTS = [
    ('mode', 'up', 'up: robots and base on this machine; robot: one robot; base: robots are on other machines'),
    ('names', '', 'modes up and base: names of the robots, separated by commas; their namespaces in ROS'),
    ('name', '', 'mode robot: name of the robot, as the base has it in names'),
    ('base', '', 'mode robot: endpoint of the base, such as quic/192.168.1.10:7447'),
    ('plain_names', 'false', 'mode robot: true if its topics are /scan and not /NAME/scan'),
    ('world', 'ros', 'modes up and robot: ros for real robots and Gazebo, simulator for simulated ones'),
    ('twist_stamped', 'true', 'whether robots take TwistStamped, as TurtleBot3 does from Jazzy on'),
    ('config', '', 'fleet file; it takes the place of twist_stamped'),
    ('options', '', 'further options of mr-slam, such as "--page off --record"'),
    ('program', 'mr-slam', 'path of the program mr-slam'),
    ('rviz', 'false', 'true starts RViz'),
]


def command_line(values, config_folder):
    """Returns the command of the program for the launch arguments; raises ValueError if one is missing."""
    mode = values['mode']
    if mode not in ('up', 'robot', 'base'):
        raise ValueError(f'mode:={mode}: expected up, robot or base')
    command = [values['program'], mode]
    for argument in {'up': [], 'robot': ['name', 'base'], 'base': ['names']}[mode]:
        if not values[argument]:
            raise ValueError(f'mode:={mode} needs {argument}:=...')
    if mode == 'robot':
        command += ['--name', values['name'], '--base', values['base']]
        if values['plain_names'] == 'true':
            command.append('--plain-names')
    elif values['names']:
        command += ['--names', values['names']]
    if mode != 'base':
        command += ['--world', values['world']]
    config = values['config']
    if not config and values['twist_stamped'] == 'true':
        config = os.path.join(config_folder, 'twist_stamped.toml')
    if config:
        command += ['--config', config]
    return command + shlex.split(values['options'])


def start(context):
    """Returns the actions for the launch arguments of this launch."""
    values = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    share = get_package_share_directory('mr_slam')
    actions = [
        ExecuteProcess(
            cmd=command_line(values, os.path.join(share, 'config')),
            name='mr_slam',
            output='screen',
            sigterm_timeout=STOP_S,
            sigkill_timeout=STOP_S,
        )
    ]
    if values['rviz'] == 'true':
        rviz = os.path.join(share, 'rviz', 'mr_slam.rviz')
        actions.append(Node(package='rviz2', executable='rviz2', name='rviz2', arguments=['-d', rviz]))
    return actions


def generate_launch_description():
    """Declares the launch arguments, and starts what they ask for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text) for name, default, text in ARGUMENTS
    ]
    return LaunchDescription(declared + [OpaqueFunction(function=start)])
