"""One step of a reconstruction with pycolmap: steps.py STEP LENS SAME_CAMERA MATCHING LARGEST_SIDE [MODEL]"""

import sys

import pycolmap

step, lens, same_camera, matching, largest = sys.argv[1:6]
database, photos, sparse, out = "database.db", "photos", "sparse", "out"
device = pycolmap.Device.cpu
if step == "features":
    mode = pycolmap.CameraMode.SINGLE if same_camera == "1" else pycolmap.CameraMode.PER_IMAGE
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = lens
    pycolmap.extract_features(database, photos, camera_mode=mode, reader_options=reader, device=device)
elif step == "matches":
    match = pycolmap.match_sequential if matching == "sequential" else pycolmap.match_exhaustive
    match(database, device=device)
elif step == "mapping":
    pycolmap.set_random_seed(0)
    pycolmap.incremental_mapping(database, photos, sparse)
elif step == "undistortion":
    options = pycolmap.UndistortCameraOptions()
    options.max_image_size = int(largest)
    pycolmap.undistort_images(out, sys.argv[6], photos, undistort_options=options)
