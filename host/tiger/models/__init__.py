"""Physics: mechanism, quarter, full car, 14-DOF vehicle, tyres, roads and sensors."""
