"""Grounding DINO and SAM in the smallest sizes that their code takes, with random weights, saved as users have them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

WORDS = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", ".", "?", "a", "person"]


def save_tiny_models(folder: Path) -> None:
    """``grounding-dino/`` and ``sam/`` in ``folder``; a few hundred kB."""
    torch: Any = import_module("torch")
    torch.manual_seed(0)
    _save_detector(folder / "grounding-dino")
    _save_outliner(folder / "sam")


def _save_detector(folder: Path) -> None:
    folder.mkdir(parents=True)
    transformers: Any = import_module("transformers")
    sizes = {"d_model": 32, "encoder_ffn_dim": 32, "decoder_ffn_dim": 32, "num_queries": 20, "max_text_len": 16}
    # With one decoder layer the two-stage heads have nothing to share.
    layers = {"encoder_layers": 1, "decoder_layers": 2, "encoder_attention_heads": 2, "decoder_attention_heads": 2}
    config = transformers.GroundingDinoConfig(
        backbone_config=transformers.SwinConfig(
            embed_dim=12, depths=[1, 1, 1, 1], num_heads=[1, 1, 1, 1], window_size=4, image_size=64,
            out_features=["stage2", "stage3", "stage4"],
        ),
        text_config=transformers.BertConfig(
            vocab_size=len(WORDS), hidden_size=32, num_hidden_layers=1, num_attention_heads=2, intermediate_size=32,
            max_position_embeddings=32,
        ),
        **sizes, **layers,
    )  # fmt: skip
    transformers.GroundingDinoForObjectDetection(config).save_pretrained(folder)
    (folder / "vocab.txt").write_text("\n".join(WORDS) + "\n")
    transformers.BertTokenizer.from_pretrained(folder).save_pretrained(folder)
    size = {"shortest_edge": 96, "longest_edge": 128}
    transformers.GroundingDinoImageProcessorPil(size=size).save_pretrained(folder)


def _save_outliner(folder: Path) -> None:
    transformers: Any = import_module("transformers")
    config = transformers.SamConfig(
        vision_config=transformers.SamVisionConfig(
            hidden_size=16, output_channels=16, num_hidden_layers=2, num_attention_heads=2, image_size=64,
            patch_size=8, mlp_dim=32, window_size=4, global_attn_indexes=[1], num_pos_feats=8,
        ),
        prompt_encoder_config=transformers.SamPromptEncoderConfig(
            hidden_size=16, image_size=64, patch_size=8, mask_input_channels=4
        ),
        mask_decoder_config=transformers.SamMaskDecoderConfig(
            hidden_size=16, mlp_dim=32, num_attention_heads=2, iou_head_hidden_dim=16, num_hidden_layers=2
        ),
    )  # fmt: skip
    transformers.SamModel(config).save_pretrained(folder)
    transformers.SamImageProcessorPil(
        size={"longest_edge": 64}, pad_size={"height": 64, "width": 64}, mask_size={"longest_edge": 16},
        mask_pad_size={"height": 16, "width": 16},
    ).save_pretrained(folder)  # fmt: skip
