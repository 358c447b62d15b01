import { useState } from "preact/hooks";
import { api, told } from "../net/api";
import { useAsked } from "../ui/asked";

/** What a recording is called; nothing while that is not known. */
export function RecordingName({ id }: { id: string }) {
  const [name, setName] = useState<string | null>(null);
  useAsked(
    () => told(api.GET("/api/recordings/{id}", { params: { path: { id } } })),
    (recording) => setName(recording.name),
    [id],
  );
  return name === null ? null : <>, {name}</>;
}
