# Lines for what the first lines of README leave out; test_readme.py runs them as it runs those.
manip3d info head.obj
manip3d simplify light.glb -o lighter.glb --ratio 0.5       # glTF to glTF: names, looks, skins stay
manip3d lod head.obj -o short.glb --quantize                # 16 bits for positions and UVs
manip3d lod head.obj -o one.glb --mode published            # all levels from a single run
manip3d simplify head.obj -o quick.glb --ratio 0.1 --mode fast    # speed first
manip3d simplify head.obj -o face.glb --ratio 0.1 --lock-box 0 -1 -1 1 1 1   # vertices in the box stay
manip3d simplify head.obj -o tile.glb --ratio 0.1 --lock-boundary             # boundaries stay: tiles still meet
manip3d lod head.obj -o tiles.glb --lock-boundary             # also for levels of tiles
manip3d simplify head.obj -o small.glb --ratio 0.1 --memory 8GiB  # for meshes of any size
manip3d simplify head.obj -o side.glb --ratio 0.1 --importance weights.npy  # one for each vertex
manip3d view scan.bin -o scan.html          # scans, depth images and recordings as points
manip3d convert scan.bin -o scan.csv         # text, like .xyz, .asc, .pts and .txt
manip3d inspect b.bin --previous a.bin --following c.bin --rows rows.csv --log case.jsonl
manip3d inspect drive -o drive.html --log drive.jsonl   # a drive, each scan with its neighbours
manip3d lattice clean -o lattice.json   # clean: a folder of unedited scans of another scanner, for inspect --lattice
manip3d inspect street.mcap -o street.html                                # needs bags
manip3d watermark embed drive --key sensor.key --picture image_02 -o carried   # needs alert
manip3d watermark verify carried --key sensor.key --picture image_02       # needs alert
manip3d alert run carried --key sensor.key --picture image_02 -o carried.html   # needs alert
manip3d capture record 'forged:sim:body?motion=wave&frames=60#show=0.5' -o switched        # needs simulate
manip3d forge people -o streams --people 1 --actions 1 --frames 3         # needs simulate
manip3d depth depth.png --intrinsics kinect-v2 --points 5000 --mask mask.png --confidence levels.png --confidence-max 2 -o masked.glb   # needs io
manip3d depth depth.png --intrinsics kinect-v2 --bandwidth 1e6 --rate 30 -o sent.glb   # needs io
manip3d depth depth.png --intrinsics kinect-v2 --ray-depth --points 5000 -o flat.glb   # distances along the lines of sight; needs io
manip3d depth rgbd/depth/ --intrinsics tum --points 5000 --poses rgbd/groundtruth.txt -o room.glb   # tens of views, not thousands; needs io
manip3d play frames/ -o film.html --rate 30      # a folder of meshes from depth, with a time bar
manip3d capture record 'sim:body?motion=stepping&chair=wheelchair&amputated=right-leg&dressing=bandage&frames=12' -o wheelchair  # needs simulate
manip3d capture record walk.bag -o walk                                   # a RealSense's; needs bags
manip3d capture record 'sim:body?motion=wave&frames=30' -o visit --trigger person --before 1  # needs simulate
manip3d phantom render a3_s1_t1_depth.mat --limb left-arm -o a3_s1_t1  # UTD-MHAD, with its joints beside it; needs simulate
manip3d phantom live --game bubbles --no-open --seconds 3                          # needs live
manip3d phantom live --host 127.0.0.1 --certificate live.pem --no-open --seconds 3 # needs live
manip3d diary check study.diary            # reads every page and entry, checks the audit; needs diary
manip3d diary rescue study.diary -o rescued.diary  # readable entries of a damaged diary; needs diary
manip3d diary export study.diary -o pages --pages                                  # needs diary
manip3d diary form ownership -o form.json                                          # needs diary
manip3d diary ask study.diary P01 --form form.json --answers=3,2,2,-1,0,0          # needs diary
manip3d diary consent study.diary P01 --clips                                      # needs diary
manip3d diary clips study.diary P01 -o clips                                       # needs diary
manip3d study simulate study.toml -o trial --participants 6
