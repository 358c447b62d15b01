import { signal } from "@preact/signals";
import { api, resultOf, type Room } from "../net/api";

/** Workspace, arm shape and scan settings, which are constant while the service runs. Null: not requested yet. */
export const room = signal<Room | null>(null);

/** Request them. */
export async function loadRoom(): Promise<void> {
  const answer: unknown = await resultOf(api.GET("/api/cell/room"));
  room.value = answer as Room; // the client types corners as lists of any length
}
