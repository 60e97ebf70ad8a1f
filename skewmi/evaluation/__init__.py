"""What commands compute and draw: episodes and their figures, learning curves, films.

| May import | What for |
|---|---|
| `policy_io`, `success`, `batch_env`, `contact`, `trajectory`, `errors` | policies, environments |
| `train`'s readers of runs (`checkpoint`, `config`, `history`, `log`, `milestones`) | curves |
| `deploy.recording`'s reader and `deploy.wire`'s messages | films |
| `sim`'s rendering and scenes, only inside functions | films |

Never `cli`, which alone imports this; never `export`, tyro or, on import, `sim`. Only `learning`
and `figures`, which read run directories, need torch.
"""
