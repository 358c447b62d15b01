"""Recognition in its own process, the files of a result, and reading uploaded recordings in a sandbox.

In go recordings, or the views of a running scan. Out come the model, the cloud, the preview and the outcome of each
view. The rest of the service uses `RecognitionWorker`, `describe_recording` and `describe_untrusted_recording`.
"""
