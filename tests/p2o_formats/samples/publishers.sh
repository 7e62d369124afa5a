#!/bin/bash
Z=-0.08
# ros2 run tf2_ros static_transform_publisher 9 9 9 0 0 0 velodyne camera_link
rosrun tf2_ros static_transform_publisher 0 0 0 0 0 0 map odom &
ros2 run tf2_ros static_transform_publisher --x 0.27 --y 0.06 --z $Z \
   --roll 0 --pitch 0 --yaw 0 --frame-id velodyne --child-frame-id left_camera --ros-args -r __node:=a &
/opt/ros/noetic/lib/tf/static_transform_publisher 0 0 0 -1.5707963267948966 0 -1.5707963267948966 \
   left_camera left_camera_optical 50 __name:=optical; sleep 1
