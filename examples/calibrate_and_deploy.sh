#!/bin/sh
# From a robot that nobody knows to one that does the task: excite, identify, evaluate, deploy.
#
#   sh examples/calibrate_and_deploy.sh [FOLDER]
#
# The robot is simulated, and is what the variation file says; nothing but the simulated robot reads
# that file. On a real one leave out --variation and --lock-step and give --connect LOCATOR.
set -eu
folder=${1:-calibrated}
skewmi=${SKEWMI:-skewmi}
seconds=${SECONDS_OF_MOTION:-60}
mkdir -p "$folder"

# Soft shoulders, a stiff elbow, three times the friction, and commands that come 23.7 ms late.
cat > "$folder/robot.yaml" <<'ROBOT'
servo:
  kp_scale: [0.5, 0.6, 0.6, 1.4, 1.2, 0.7, 1.5]
  kd_scale: [1.2, 1.1, 0.8, 1.5, 0.9, 1.3, 0.6]
  frictionloss: [1.5, 1.2, 1.0, 0.8, 0.2, 0.4, 0.3]
  delay_ms: 23.7
sensors: {joint_noise: 0.0001, lid_bias_deg: 2.0}
box_pose: {x: 0.003, y: -0.002, yaw_deg: 1.5}
ROBOT
robot="--variation $folder/robot.yaml --lock-step"

echo "== what the shipped policy does on it, nothing known"
$skewmi evaluate open_press_close --episodes 50 --variation "$folder/robot.yaml"

echo "== excite: the arm moves above the scene"
$skewmi calibrate excite $robot --seconds "$seconds" --out "$folder/excitation.mcap" --overwrite
$skewmi calibrate excite $robot --seconds 15 --seed 100 --out "$folder/held-out.mcap" --overwrite

echo "== servo: what its servos are"
$skewmi calibrate servo "$folder/excitation.mcap" --held-out "$folder/held-out.mcap" \
    --out "$folder/robot-servo.yaml" --report "$folder/report.html" --overwrite

echo "== scene: where the box stands, by touching it"
$skewmi calibrate scene $robot --calibration "$folder/robot-servo.yaml" \
    --out "$folder/robot-known.yaml" --overwrite

echo "== what the shipped policy does on it with that known"
$skewmi evaluate open_press_close --episodes 50 --variation "$folder/robot.yaml" \
    --calibration "$folder/robot-known.yaml"

echo "== deploy"
$skewmi deploy open_press_close $robot --calibration "$folder/robot-known.yaml" --episodes 3 \
    --record "$folder/run.mcap" --overwrite
$skewmi replay "$folder/run.mcap" --out "$folder/run.rrd" --overwrite
