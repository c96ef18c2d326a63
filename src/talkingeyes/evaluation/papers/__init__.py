"""The tables of the papers: TalkingEyes' Tables II to VII, ProbTalk3D's Table 1, PoseGAN's Tables 1 to 3."""
